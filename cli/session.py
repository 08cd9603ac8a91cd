"""What the commands have in common that ask a service: their options, ids in short, and how they print."""

from __future__ import annotations

import inspect
import json
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Concatenate, ParamSpec

import typer

from fastsplat.cli.connection import KEY_VARIABLE, SAMPLE, SERVER_VARIABLE, Place, is_data_folder, open_client
from fastsplat.cli.short_ids import LEAST, whole_id
from fastsplat.cli.tables import duration
from fastsplat_contract.errors import NotFoundError, NotReadyError
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.operations import Operation

if TYPE_CHECKING:
    from fastsplat_client import Client

P = ParamSpec("P")

_PANEL = "Which service"
_ID_LENGTH = 32
_POLL_S = 0.5

SceneId = Annotated[
    str,
    typer.Argument(
        metavar="SCENE",
        help=f"A scene's id, or its first letters, {LEAST} at least. Without --server and --data also a folder that "
        f"fastsplat train has made, or {SAMPLE}: the scene in it.",
    ),
]
JobId = Annotated[str, typer.Argument(metavar="JOB", help=f"A job's id, or its first letters, {LEAST} at least.")]
Version = Annotated[
    str, typer.Option(help=f"Of the scene; {LEAST} letters of its name will do. Default: the current one.")
]
Watch = Annotated[
    bool, typer.Option("--watch", help="Follow the job to its end, and print what came of it; status 1 if it fails.")
]


class Session:
    """One run of a command.

    Args:
        place: which service it asks, once it asks.
        as_json: whether it prints JSON.
    """

    def __init__(self, place: Place, *, as_json: bool) -> None:
        self.place = place
        self.as_json = as_json
        self._opened = ExitStack()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *exception: object) -> None:
        self._opened.close()

    @cached_property
    def client(self) -> Client:
        """Of the service; see `open_client`."""
        return self._opened.enter_context(open_client(self.place))

    def scene(self, text: str) -> str:
        """The whole id of a scene, of an argument `SceneId`.

        Raises:
            NotFoundError, InvalidInputError: as `whole_id`.
            NotReadyError: the scene of a folder has not been trained to its end.
        """
        if not self.place.server and not self.place.data and is_data_folder(text):
            self.place = replace(self.place, data=text)
            scene = next(self.client.scenes(), None)
            if scene is None:
                raise NotFoundError(f"there is no scene in {text}", field="SCENE")
            if scene.state != "READY":
                raise NotReadyError(f"the scene in {text} has not been trained to its end", field="SCENE")
            return scene.id
        return self._whole(text, "scene", lambda: (each.id for each in self.client.scenes()))

    def job(self, text: str) -> str:
        """The whole id of a job; errors as `whole_id`."""
        return self._whole(text, "job", lambda: (each.id for each in self.client.operations()))

    def key(self, text: str) -> str:
        """The whole id of a key of the project; errors as `whole_id`."""
        return whole_id("key", text, (each.id for each in self.client.keys.all()))

    def version(self, scene_id: str, text: str) -> str:
        """The whole name of a version of a scene, "" for "": the current one; errors as `whole_id`."""
        return text and whole_id("version", text, (each.version for each in self.client.versions(scene_id)))

    def current(self, scene_id: str) -> str:
        """The name of the version that is current."""
        return next(each.version for each in self.client.versions(scene_id) if each.current)

    def tell(self, value: Any, text: str = "", *, nothing: str = "") -> None:
        """Print a value of the contract.

        Args:
            value: as JSON, as REST would send it; None for what has no content.
            text: for people.
            nothing: said on stderr where there is no text.
        """
        if self.as_json:
            if value is not None:
                typer.echo(json.dumps(to_plain(value), indent=2, ensure_ascii=False))
        elif text:
            typer.echo(text)
        elif nothing:
            typer.echo(nothing, err=True)

    def tell_job(self, operation: Operation, text: Callable[[Operation], str], *, watch: bool) -> None:
        """Print a job that was queued, or with `watch` what came of it; what happens meanwhile are lines on stderr.

        Args:
            operation: as it was queued.
            text: what came of one that succeeded, for people.
            watch: whether to wait for its end.

        Raises:
            typer.Exit: it was watched, and did not succeed.
        """
        queued = f"job {operation.id} of scene {operation.scene_id} is {operation.state}"
        if not watch:
            self.tell(operation, queued)
            return
        typer.echo(queued, err=True)
        shown = ""
        while True:
            if (line := progress(operation)) != shown:
                typer.echo(shown := line, err=True)
            if operation.done:
                break
            time.sleep(_POLL_S)
            operation = self.client.operation(operation.id)
        succeeded = operation.state == "SUCCEEDED"
        self.tell(operation, text(operation) if succeeded else "")
        if not succeeded:
            raise typer.Exit(1)

    def _whole(self, text: str, noun: str, ids: Callable[[], Any]) -> str:
        return text if len(text) == _ID_LENGTH else whole_id(noun, text, ids())


def progress(operation: Operation) -> str:
    """Where a job stands, in one line."""
    if operation.error is not None:
        hint = operation.error.details.get("hint", "")
        return f"{operation.error.stage}: {operation.error.reason}: {operation.error.message}. {hint}".rstrip()
    if operation.done or not operation.stages:
        return str(operation.state)
    last = operation.stages[-1]
    left = "" if operation.seconds_left is None else f", about {duration(operation.seconds_left)} left in all"
    return f"{last.stage} {last.fraction:.0%} {last.message}{left}"


def service_command(
    group: typer.Typer, name: str | None = None, *, json: bool = True
) -> Callable[[Callable[Concatenate[Session, P], None]], Callable[Concatenate[Session, P], None]]:
    """A decorator: adds a command that asks a service to a group, with the options that all of these have; without
    `json`, a command that goes on until it is stopped, and prints no value."""

    def register(
        function: Callable[Concatenate[Session, P], None],
    ) -> Callable[Concatenate[Session, P], None]:
        common = {option: each for option, each in _COMMON.items() if json or option != _JSON}

        def run(**values: Any) -> None:
            options = {option: values.pop(option) for option in common}
            as_json = options.pop(_JSON, False)
            with Session(Place(**options), as_json=as_json) as session:
                function(session, **values)  # type: ignore[call-arg]  # all but the session, by name

        own = [*inspect.signature(function, eval_str=True).parameters.values()][1:]
        run.__name__, run.__doc__ = function.__name__, function.__doc__
        run.__signature__ = inspect.Signature([*own, *common.values()])  # type: ignore[attr-defined]
        group.command(name)(run)
        return function

    return register


def _options(
    server: Annotated[
        str,
        typer.Option(
            metavar="URL",
            rich_help_panel=_PANEL,
            help="A running one, e.g. https://robots.example:8000. Default: the variable "
            f"{SERVER_VARIABLE}, or else the data folder's, in this process.",
        ),
    ] = "",
    key_file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            rich_help_panel=_PANEL,
            help=f"Has your key for the server. Default: the variable {KEY_VARIABLE} has the key.",
        ),
    ] = None,
    ca: Annotated[
        Path | None,
        typer.Option(metavar="FILE", rich_help_panel=_PANEL, help="PEM certificates to trust, not the system's."),
    ] = None,
    data: Annotated[
        str,
        typer.Option(
            metavar="DIR",
            rich_help_panel=_PANEL,
            help=f"The service of this data folder, in this process; {SAMPLE}: of the sample scene. "
            "Default: FASTSPLAT_DATA_DIR.",
        ),
    ] = "",
    project: Annotated[
        str, typer.Option(rich_help_panel=_PANEL, help="Whose scenes. Default: your key's, or the default project.")
    ] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, as REST answers.")] = False,
) -> None: ...


_JSON = "as_json"
_COMMON = dict(inspect.signature(_options, eval_str=True).parameters)
