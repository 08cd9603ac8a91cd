"""The server's namer, asked about the things of a scene that have no name."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence

from fastsplat.service.application.admin.server_capabilities import agree_to_namer, namer_status, the_namer
from fastsplat.service.application.answering.thing_sheets import ThingSheets
from fastsplat.service.application.editing.versions import Versions
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.nameless_things import said_by
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import NotReadyError, PermissionDeniedError
from fastsplat_contract.name_suggestions import NamerResult, NamerStatus
from fastsplat_contract.scenes import Edit
from fastsplat_contract.thing_sheets import ThingSheet

_asking = threading.Lock()
"""One scene at a time in a process: a model of one's own has one machine, and each asking holds a thread."""


class OwnNamer:
    """The server's namer for one project. Every method is safe from any thread."""

    def __init__(self, store: Store, settings: Settings, project: str, sheets: ThingSheets, versions: Versions) -> None:
        self._store = store
        self._settings = settings
        self._project = project
        self._sheets = sheets
        self._versions = versions

    def agree(self, host: str) -> NamerStatus:
        """See `agree_to_namer`."""
        return agree_to_namer(self._store, self._settings, self._project, host)

    def ask(self, scene_id: str, author: str = "") -> NamerResult:
        """Ask it about all things without a name, and suggest what it says as one version; where it says nothing
        usable there is none. What goes to it are the sheets' pictures, with sizes and the names of neighbors.

        Args:
            scene_id: which scene.
            author: the id of the key by which this is asked for; "" for none.

        Raises:
            ModelUnavailableError: the server has no namer.
            PermissionDeniedError: the project did not agree to its host. Nothing is sent.
            NotFoundError: there is no such scene.
            NotReadyError: the scene is not ready, or the namer is being asked about another one.
            NamerError: it answers nothing usable at all.
        """
        self._store.scenes.scene(scene_id)
        namer = the_namer(self._settings)
        self._check_agreed(namer.host)
        # All are drawn before the first is sent: drawing may begin anew on other threads, and nothing is sent twice.
        sheets = self._all_sheets(scene_id)
        if not _asking.acquire(blocking=False):
            raise NotReadyError("the namer is being asked about another scene", hint="Ask again in some minutes.")
        try:
            said = said_by(namer, self._while_agreed(sheets, namer.host))
        finally:
            _asking.release()
        version = sheets[-1].version
        if said.names:
            edit = Edit("suggest", suggestions=said.names)
            version = self._versions.edit(scene_id, (edit,), author=author).version
        return NamerResult(len(said.names), said.shown, said.refused, said.problem, version)

    def _check_agreed(self, host: str) -> None:
        status = namer_status(self._store, self._settings, self._project)
        if status is None or not status.agreed:
            raise PermissionDeniedError(
                f"the project did not agree that pictures of its things go to {host}",
                field="namer",
                hint="An admin of the project agrees once, on the page or by AgreeToNamer.",
            )

    def _while_agreed(self, sheets: Sequence[ThingSheet], host: str) -> Iterator[ThingSheet]:
        """Sheet by sheet, as long as the call is not cancelled and the agreement is not taken back."""
        for sheet in sheets:
            check_cancelled()
            self._check_agreed(host)
            yield sheet

    def _all_sheets(self, scene_id: str) -> list[ThingSheet]:
        sheets = [self._sheets.page(scene_id)]
        while sheets[-1].next_page_token:
            sheets.append(self._sheets.page(scene_id, page_token=sheets[-1].next_page_token))
        return sheets
