"""What people named in the scenes of a project."""

from __future__ import annotations

from collections.abc import Iterator

from fastsplat_client.table_calls import TableCalls
from fastsplat_contract import calls, requests
from fastsplat_contract.known_names import (
    AddNamePackRequest,
    CheckKnownNamesRequest,
    ExportNamePackRequest,
    KnownName,
    KnownNamesCheck,
    KnownPack,
    NamePack,
)


class ClientKnownNames(TableCalls):
    """Known names of the client's project. All calls raise as those of `Client`."""

    def all(self) -> Iterator[KnownName]:
        """The names that people gave and that are suggested in other scenes, newest first, page by page."""
        pages = self._pages(calls.LIST_KNOWN_NAMES, requests.ListKnownNamesRequest())
        return (name for page in pages for name in page.names)

    def forget(self, name_id: str) -> None:
        """Suggest a name no more, and remove what it looks like; its scene keeps the name."""
        self.call(calls.DELETE_KNOWN_NAME, requests.DeleteKnownNameRequest(name_id))

    def forget_all(self) -> None:
        """As `forget`, of every name of the project."""
        self.call(calls.DELETE_KNOWN_NAMES, requests.DeleteKnownNamesRequest())

    def packs(self) -> tuple[KnownPack, ...]:
        """The packs that were added, newest first; `forget` forgets one by its id."""
        return self.call(calls.LIST_KNOWN_NAMES, requests.ListKnownNamesRequest(page_size=1)).packs

    def check(self, pack: NamePack | None = None) -> KnownNamesCheck:
        """How well names are known again in scenes left out in turn; with a pack, before it is added."""
        return self.call(calls.CHECK_KNOWN_NAMES, CheckKnownNamesRequest(pack))

    def export_pack(self, license_text: str) -> NamePack:
        """What the project knows by looks, to be written to a file by `fastsplat_contract.json_codec.to_json`."""
        return self.call(calls.EXPORT_NAME_PACK, ExportNamePackRequest(license_text))

    def add_pack(self, pack: NamePack) -> KnownPack:
        """Suggest the names of a pack in the project's scenes."""
        return self.call(calls.ADD_NAME_PACK, AddNamePackRequest(pack))
