"""Options of all commands that ask a service, and their session."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Concatenate, ParamSpec

import typer

from fastsplat.cli.connection import KEY_VARIABLE, SAMPLE, SERVER_VARIABLE, Address
from fastsplat.cli.session import Session
from fastsplat.cli.short_ids import LEAST

P = ParamSpec("P")

_PANEL = "Which service"

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
    bool, typer.Option("--watch", help="Follow the job to its end and print its outcome; status 1 if it fails.")
]


def service_command(
    group: typer.Typer, name: str | None = None, *, json: bool = True
) -> Callable[[Callable[Concatenate[Session, P], None]], Callable[Concatenate[Session, P], None]]:
    """Adds the decorated function to a group as a command with a session.

    Without `json` it is a command that goes on until it is stopped, and prints no value.
    """

    def register(function: Callable[Concatenate[Session, P], None]) -> Callable[Concatenate[Session, P], None]:
        common = {option: parameter for option, parameter in _COMMON.items() if json or option != _JSON}

        def run(**values: Any) -> None:
            options = {option: values.pop(option) for option in common}
            as_json = options.pop(_JSON, False)
            address = Address(**options).of_scene(values.get("scene", ""))
            with Session(address, as_json=as_json) as session:
                function(session, **values)  # type: ignore[call-arg]  # all but the session, by name

        parameters = [*inspect.signature(function, eval_str=True).parameters.values()][1:]
        run.__name__, run.__doc__ = function.__name__, function.__doc__
        run.__signature__ = inspect.Signature([*parameters, *common.values()])  # type: ignore[attr-defined]
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
