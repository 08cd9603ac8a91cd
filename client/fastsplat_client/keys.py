"""Access keys of a project, for its admins and for operators."""

from __future__ import annotations

from collections.abc import Iterator
from urllib.parse import quote

from fastsplat_client.table_calls import TableCalls
from fastsplat_contract import calls
from fastsplat_contract.messages import requests
from fastsplat_contract.server.keys import AccessKey, KeyIn, NewKey, Role, UploadKeyIn


class ClientKeys(TableCalls):
    """Keys of the client's project, of its own role at most. All calls raise as those of `Client`."""

    def create(self, name: str, role: Role = "editor", lifetime_s: float | None = None) -> NewKey:
        """Make a key; its `secret` is told this once.

        Args:
            name: whose key it is, for people.
            role: what it may do; at most the client's own.
            lifetime_s: seconds until it expires; None: never.
        """
        return self.call(calls.CREATE_KEY, KeyIn(name, role, lifetime_s))

    def create_for_upload(self, lifetime_s: float | None = None) -> NewKey:
        """Make a key with which somebody else may post one scene; its `secret` is told this once.

        Args:
            lifetime_s: seconds until it expires, if no upload has begun with it by then; None: 15 minutes.
        """
        return self.call(calls.CREATE_UPLOAD_KEY, UploadKeyIn(lifetime_s))

    def share(self, scene_id: str, name: str, lifetime_s: float) -> NewKey:
        """Make a key that shows one scene alone, read-only; `share_link` makes a link to the page of it."""
        return self.call(calls.CREATE_KEY, KeyIn(name, "reader", lifetime_s, scene_id))

    def all(self, scene_id: str = "") -> Iterator[AccessKey]:
        """Keys, newest first, page by page; revoked and expired ones, too. With a scene, those that show it alone."""
        pages = self._pages(calls.LIST_KEYS, requests.ListKeysRequest(scene_id=scene_id))
        return (key for page in pages for key in page.keys)

    def revoke(self, key_id: str) -> AccessKey:
        """Take a key back for ever; what it has under way ends within two seconds."""
        return self.call(calls.REVOKE_KEY, requests.RevokeKeyRequest(key_id))


def share_link(server: str, made: NewKey) -> str:
    """The address of the page that shows the one scene of a key. The key stands behind the #, which browsers send to
    nobody."""
    return f"{server.rstrip('/')}/#/scenes/{quote(made.key.scene_id, safe='')}?share={made.secret}"
