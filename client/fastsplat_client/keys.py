"""Calls about a project's access keys, for admins and operators."""

from __future__ import annotations

from collections.abc import Iterator
from urllib.parse import quote

from fastsplat_client.table_calls import TableCalls
from fastsplat_contract import calls
from fastsplat_contract.messages import requests
from fastsplat_contract.server.keys import AccessKey, KeyIn, NewKey, Role, UploadKeyIn


class ClientKeys(TableCalls):
    """Keys of the client's project, up to its own role."""

    def create(self, name: str, role: Role = "editor", lifetime_s: float | None = None) -> NewKey:
        """Creates a key of at most the client's role; its `secret` is returned only here.

        Args:
            name: for display.
            lifetime_s: seconds until it expires; None: never.
        """
        return self.call(calls.CREATE_KEY, KeyIn(name, role, lifetime_s))

    def create_for_upload(self, lifetime_s: float | None = None) -> NewKey:
        """Creates a key that may post one scene; its `secret` is returned only here.

        It expires after `lifetime_s` (None: 15 minutes) unless an upload has begun.
        """
        return self.call(calls.CREATE_UPLOAD_KEY, UploadKeyIn(lifetime_s))

    def share(self, scene_id: str, name: str, lifetime_s: float) -> NewKey:
        """Creates a read-only key of one scene; `share_link` turns it into a link."""
        return self.call(calls.CREATE_KEY, KeyIn(name, "reader", lifetime_s, scene_id))

    def all(self, scene_id: str = "") -> Iterator[AccessKey]:
        """Lists keys, newest first, also revoked and expired ones; optionally a scene's share keys."""
        pages = self._pages(calls.LIST_KEYS, requests.ListKeysRequest(scene_id=scene_id))
        return (key for page in pages for key in page.keys)

    def revoke(self, key_id: str) -> AccessKey:
        """Revokes a key for good; its running calls end within two seconds."""
        return self.call(calls.REVOKE_KEY, requests.RevokeKeyRequest(key_id))


def share_link(server: str, new_key: NewKey) -> str:
    """Builds the link to a shared scene; browsers send nothing after #, the secret's place.

    Examples:
        >>> from datetime import datetime
        >>> key = AccessKey("k1", "guest", "home", "reader", "VALID", datetime.now(), None, None, scene_id="s1")
        >>> share_link("https://robots.example:8000/", NewKey(key, "secret"))
        'https://robots.example:8000/#/scenes/s1?share=secret'
    """
    return f"{server.rstrip('/')}/#/scenes/{quote(new_key.key.scene_id, safe='')}?share={new_key.secret}"
