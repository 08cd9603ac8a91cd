"""What people named in the scenes of a project."""

from __future__ import annotations

from collections.abc import Iterator

from fastsplat_client.table_calls import TableCalls
from fastsplat_contract import calls
from fastsplat_contract.messages import requests
from fastsplat_contract.messages.known_names import KnownName


class ClientKnownNames(TableCalls):
    """Known names of the client's project. All calls raise as those of `Client`."""

    def all(self) -> Iterator[KnownName]:
        """The names that people gave and that are suggested in other scenes, newest first, page by page."""
        pages = self._pages(calls.LIST_KNOWN_NAMES, requests.ListKnownNamesRequest())
        return (name for page in pages for name in page.names)

    def forget(self, name_id: str) -> None:
        """Suggest a name, or with "all" every name of the project, no more, and remove what it looks like; scenes keep
        their names."""
        self.call(calls.DELETE_KNOWN_NAME, requests.DeleteKnownNameRequest(name_id))
