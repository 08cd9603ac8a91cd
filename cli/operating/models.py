"""`fastsplat models`: which models there are, and how they come into the model directory."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from fastsplat.cli.lazy_settings import load_settings
from fastsplat.cli.tables import Column, table
from fastsplat_contract.errors import FastSplatError

if TYPE_CHECKING:  # loads OpenCV and onnxruntime, which the other commands do without
    from fastsplat.service.perception.model_pull.pull import Step

models_app = typer.Typer(
    name="models", help="The models that look and read: list them, pull them.", no_args_is_help=True
)

_Directory = Annotated[
    Path | None,
    typer.Option(
        "--models",
        help="Model directory. Default: FASTSPLAT_MODELS; models in the data folder, or .models here, if there is one; "
        "or the user's own.",
    ),
]
_Manifest = Annotated[Path | None, typer.Option("--manifest", help="Another manifest than the built-in one.")]


@models_app.command("list")
def list_models(
    models: _Directory = None,
    manifest: _Manifest = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print a JSON array instead of a table.")] = False,
) -> None:
    """Show every model of the manifest and what the model directory holds of it."""
    from fastsplat.service.perception.model_pull.pull import model_state
    from fastsplat.service.perception.models.model_manifest import load_manifest

    directory = models or load_settings().models
    with _errors(Console()):
        listed = [(entry, model_state(entry, directory)) for entry in load_manifest(manifest)]
    if as_json:
        rows = [
            {"name": e.name, "default": e.default, "state": state, "license": e.license, "role": e.role}
            for e, state in listed
        ]
        typer.echo(json.dumps(rows, indent=2))
        return
    typer.echo(f"in {directory}", err=True)
    columns = (Column("name", "cut"), Column("state", "cut"), Column("license", "cut"), Column("role"))
    typer.echo(
        table(
            columns,
            [
                (f"{e.name} (default)" if e.default else e.name, state, e.license, e.role.replace("_", " "))
                for e, state in listed
            ],
        )
    )


@models_app.command("pull")
def pull(
    names: Annotated[list[str] | None, typer.Argument(help="Models of the manifest; none: the defaults.")] = None,
    models: _Directory = None,
    manifest: _Manifest = None,
    allow_license: Annotated[
        list[str] | None,
        typer.Option("--allow-license", "--allow-licence", help="Accept this license (SPDX) too; may be repeated."),
    ] = None,
    revision: Annotated[
        str | None, typer.Option(help="Commit (40 hex digits) for Hugging Face repositories without a pinned one.")
    ] = None,
) -> None:
    """Fetch models, verify, convert and try them, and only then put them in place."""
    with _errors(Console()):
        pull_with_progress(
            models or load_settings().models,
            names or (),
            manifest=manifest,
            allow_licenses=allow_license or (),
            revision=revision,
        )


def pull_with_progress(
    directory: Path,
    names: Sequence[str] = (),
    *,
    manifest: Path | None = None,
    allow_licenses: Sequence[str] = (),
    revision: str | None = None,
) -> None:
    """`service.perception.model_pull.pull.pull` with a line a model that says how far it is."""
    from fastsplat.service.perception.model_pull.pull import pull as pull_models

    with _progress() as report:
        pull_models(
            directory, names, report=report, manifest=manifest, allow_licenses=allow_licenses, revision=revision
        )


@models_app.command("unpack")
def unpack(
    archive: Annotated[Path, typer.Argument(metavar="FILE", help="A zip of folders of a model directory.")],
    models: _Directory = None,
) -> None:
    """Put the models of a file in place, verified and tried as if pulled."""
    from fastsplat.service.perception.model_pull.model_archive import unpack as unpack_models

    with _errors(Console()), _progress() as report:
        unpack_models(archive, models or load_settings().models, report=report)


@contextmanager
def _progress() -> Iterator[Callable[[Step], None]]:
    """A line a model that says how far it is; yields what hears each step."""
    columns = (
        SpinnerColumn(),
        TextColumn("{task.fields[model]}"),
        BarColumn(bar_width=12),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    tasks: dict[str, TaskID] = {}
    with Progress(*columns) as progress:

        def report(step: Step) -> None:
            if step.model not in tasks:
                tasks[step.model] = progress.add_task(step.what, model=step.model, total=None)
            finished = step.what in ("ready", "already there")
            total, done = (1, 1) if finished else (step.total or None, step.done)
            progress.update(tasks[step.model], description=step.what, total=total, completed=done)

        yield report


class _errors:  # noqa: N801 - reads as a phrase after "with"
    """Print a product error with its hint and leave with status 1."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, FastSplatError):
            self._console.print(f"[red]error:[/red] {error.message}", soft_wrap=True, highlight=False)
            if error.hint:
                self._console.print(error.hint, soft_wrap=True, highlight=False)
            raise typer.Exit(1) from error
