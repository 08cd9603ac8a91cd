"""Access keys of a project, for its admins and for operators."""

from __future__ import annotations

from collections.abc import Iterator
from urllib.parse import quote

from fastsplat_client.errors import read
from fastsplat_client.transport import Transport
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.keys import AccessKey, KeyIn, KeyList, LifetimeIn, NewKey, Role, UploadKeyIn


class ClientKeys:
    """Keys of the client's project, of its own role at most. All calls raise as those of `Client`."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def create(self, name: str, role: Role = "editor", lifetime_s: float | None = None) -> NewKey:
        """Make a key; its `secret` is told this once.

        Args:
            name: whose key it is, for people.
            role: what it may do; at most the client's own.
            lifetime_s: seconds until it expires; None: never.
        """
        body = to_plain(KeyIn(name, role, lifetime_s))
        return read(NewKey, self._transport.call("POST", "/v1/keys", json=body, repeatable=False))

    def create_for_upload(self, lifetime_s: float | None = None) -> NewKey:
        """Make a key with which somebody else may post one scene; its `secret` is told this once.

        Args:
            lifetime_s: seconds until it expires, if no upload has begun with it by then; None: 15 minutes.
        """
        body = to_plain(UploadKeyIn(lifetime_s))
        return read(NewKey, self._transport.call("POST", "/v1/upload-keys", json=body, repeatable=False))

    def share(self, scene_id: str, name: str, lifetime_s: float) -> NewKey:
        """Make a key that shows one scene alone, read-only; `share_link` makes a link to the page of it.

        Args:
            scene_id: which scene.
            name: for whom, for people.
            lifetime_s: seconds until it expires.
        """
        body = to_plain(KeyIn(name, "reader", lifetime_s, scene_id))
        return read(NewKey, self._transport.call("POST", "/v1/keys", json=body, repeatable=False))

    def all(self, scene_id: str = "") -> Iterator[AccessKey]:
        """Keys, newest first, page by page; revoked and expired ones, too. With a scene, those that show it alone."""
        token = ""
        while True:
            params = {"page_token": token} | ({"scene_id": scene_id} if scene_id else {})
            page = read(KeyList, self._transport.call("GET", "/v1/keys", params=params))
            yield from page.keys
            if not (token := page.next_page_token):
                return

    def revoke(self, key_id: str) -> AccessKey:
        """Take a key back for ever; what it has under way ends within two seconds."""
        return read(AccessKey, self._transport.call("POST", f"/v1/keys/{quote(key_id, safe='')}:revoke"))

    def expire(self, key_id: str, lifetime_s: float) -> AccessKey:
        """Let a valid key expire in `lifetime_s` seconds, sooner or later than it would."""
        path = f"/v1/keys/{quote(key_id, safe='')}:expire"
        return read(AccessKey, self._transport.call("POST", path, json=to_plain(LifetimeIn(lifetime_s))))


def share_link(server: str, made: NewKey) -> str:
    """The address of the page that shows the one scene of a key. The key stands behind the #, which browsers send to
    nobody."""
    return f"{server.rstrip('/')}/#/scenes/{quote(made.key.scene_id, safe='')}?share={made.secret}"
