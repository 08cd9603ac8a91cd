"""A command's run against a service: its client, short ids, and output."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from functools import cached_property
from typing import TYPE_CHECKING, Any

import typer

from fastsplat.cli.connection import Address, open_client
from fastsplat.cli.short_ids import whole_id
from fastsplat.service.library.job_lines import ProgressLines
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.errors import NotFoundError, NotReadyError
from fastsplat_contract.jobs.operations import Operation

if TYPE_CHECKING:
    from fastsplat_client import Client

_ID_LENGTH = 32


class Session(AbstractContextManager["Session"]):
    """One run of a command.

    Args:
        address: which service it asks, once it asks.
        as_json: whether it prints JSON.
    """

    def __init__(self, address: Address, *, as_json: bool) -> None:
        self.address = address
        self.as_json = as_json
        self._opened = ExitStack()

    def __exit__(self, *exception: object) -> None:
        self._opened.close()

    @cached_property
    def client(self) -> Client:
        """Of the service; see `open_client`."""
        return self._opened.enter_context(open_client(self.address))

    def scene(self, text: str) -> str:
        """Completes a scene's id; of a folder, its newest one. Raises as `whole_id`.

        Raises:
            NotReadyError: the scene of a folder has not been trained to its end.
        """
        if text and text == self.address.data:
            scene = next(self.client.scenes(), None)
            if scene is None:
                raise NotFoundError(f"there is no scene in {text}", field="SCENE")
            if not scene.version:
                raise NotReadyError(f"the scene in {text} has not been trained to its end", field="SCENE")
            return scene.id
        return self._whole(text, "scene", lambda: (scene.id for scene in self.client.scenes()))

    def job(self, text: str) -> str:
        """The whole id of a job; errors as `whole_id`."""
        return self._whole(text, "job", lambda: (operation.id for operation in self.client.operations()))

    def key(self, text: str) -> str:
        """The whole id of a key of the project; errors as `whole_id`."""
        return whole_id("key", text, (key.id for key in self.client.keys.all()))

    def version(self, scene_id: str, text: str) -> str:
        """Completes the name of a scene's version; "" is the current one. Errors as `whole_id`."""
        return text and whole_id("version", text, (row.version for row in self.client.versions(scene_id)))

    def at(self, scene: str, version: str) -> tuple[str, str]:
        """Completes a scene's id and the name of a version of it, see `scene` and `version`."""
        scene_id = self.scene(scene)
        return scene_id, self.version(scene_id, version)

    def current(self, scene_id: str) -> str:
        """The name of the version that is current."""
        return next(row.version for row in self.client.versions(scene_id) if row.current)

    def tell(self, value: Any, text: str = "", *, nothing: str = "") -> None:
        """Prints `value` as REST's JSON or `text` for people, or `nothing` on stderr."""
        if self.as_json:
            if value is not None:
                typer.echo(json.dumps(to_plain(value), indent=2, ensure_ascii=False))
        elif text:
            typer.echo(text)
        elif nothing:
            typer.echo(nothing, err=True)

    def tell_job(self, operation: Operation, text: Callable[[Operation], str], *, watch: bool) -> None:
        """Prints a queued job, or with `watch` its outcome; `typer.Exit` if it fails."""
        queued = f"job {operation.id} of scene {operation.scene_id} is {operation.state}"
        if not watch:
            self.tell(operation, queued)
            return
        typer.echo(queued, err=True)
        tell_progress = ProgressLines(sys.stderr)
        for operation in self.client.watch(operation.id):  # noqa: B020  the last one is what came of it
            tell_progress(operation)
        succeeded = operation.state == "SUCCEEDED"
        self.tell(operation, text(operation) if succeeded else "")
        if not succeeded:
            raise typer.Exit(1)

    def _whole(self, text: str, noun: str, ids: Callable[[], Any]) -> str:
        return text if len(text) == _ID_LENGTH else whole_id(noun, text, ids())
