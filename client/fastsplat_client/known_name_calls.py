"""What people named in the scenes of a project."""

from __future__ import annotations

from collections.abc import Iterator
from urllib.parse import quote

from fastsplat_client.errors import read
from fastsplat_client.transport import Transport
from fastsplat_contract.known_names import KnownName, KnownNameList


class ClientKnownNames:
    """Known names of the client's project. All calls raise as those of `Client`."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def all(self) -> Iterator[KnownName]:
        """The names that people gave and that are suggested in other scenes, newest first, page by page."""
        token = ""
        while True:
            page = read(KnownNameList, self._transport.call("GET", "/v1/known-names", params={"page_token": token}))
            yield from page.names
            if not (token := page.next_page_token):
                return

    def forget(self, name_id: str) -> None:
        """Suggest a name no more, and remove what it looks like; its scene keeps the name."""
        self._transport.call("DELETE", f"/v1/known-names/{quote(name_id, safe='')}", repeatable=False)

    def forget_all(self) -> None:
        """As `forget`, of every name of the project."""
        self._transport.call("DELETE", "/v1/known-names")
