"""Calls about a project's known names."""

from __future__ import annotations

from collections.abc import Iterator

from fastsplat_client.table_calls import TableCalls
from fastsplat_contract import calls
from fastsplat_contract.messages import requests
from fastsplat_contract.messages.known_names import KnownName


class ClientKnownNames(TableCalls):
    """Known names of the client's project."""

    def all(self) -> Iterator[KnownName]:
        """Lists names given by people and suggested in other scenes, newest first."""
        pages = self._pages(calls.LIST_KNOWN_NAMES, requests.ListKnownNamesRequest())
        return (name for page in pages for name in page.names)

    def forget(self, name_id: str) -> None:
        """Deletes a known name ("all": every one) with its appearance; scenes keep their names."""
        self.call(calls.DELETE_KNOWN_NAME, requests.DeleteKnownNameRequest(name_id))
