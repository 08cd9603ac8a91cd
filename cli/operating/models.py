"""`fastsplat models`: which models there are, how they come into the model directory, and which are in use."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from fastsplat.cli.connection import local_store
from fastsplat.cli.lazy_settings import load_settings
from fastsplat.cli.scenes.ask_command import ANY_WORD
from fastsplat.cli.tables import Column, size, table
from fastsplat_contract.errors import ModelUnavailableError

if TYPE_CHECKING:  # loads OpenCV and onnxruntime, which the other commands do without
    from fastsplat.service.common.progress import ProgressEvent
    from fastsplat.service.perception.model_pull.pull import Step
    from fastsplat.service.perception.models.model_manifest import ModelEntry

models_app = typer.Typer(
    name="models", help="The models that look and read: list them, pull them, use them.", no_args_is_help=True
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
_Licenses = Annotated[
    list[str] | None,
    typer.Option("--allow-license", "--allow-licence", help="Accept this license (SPDX) too; may be repeated."),
]
_Revision = Annotated[
    str | None,
    typer.Option(help="Commit, branch or tag for Hugging Face repositories without a pinned one. Default: the newest."),
]


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
    listed = [(entry, model_state(entry, directory)) for entry in load_manifest(manifest)]
    if as_json:
        rows = [
            {"name": e.name, "default": e.default, "state": state, "license": e.license, "role": e.role}
            for e, state in listed
        ]
        typer.echo(json.dumps(rows, indent=2))
        return
    typer.echo(f"in {directory}; what is in use: fastsplat status", err=True)
    columns = (Column("name", "cut"), Column("state", "cut"), Column("license", "cut"), Column("role"))
    lines = [
        (f"{e.name} (default)" if e.default else e.name, state, e.license, e.role.replace("_", " "))
        for e, state in listed
    ]
    typer.echo(table(columns, lines))
    typer.echo(ANY_WORD, err=True)


@models_app.command("pull")
def pull(
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Models or sets of the manifest, or a zip of folders of models; none: the defaults."),
    ] = None,
    models: _Directory = None,
    manifest: _Manifest = None,
    allow_license: _Licenses = None,
    revision: _Revision = None,
) -> None:
    """Fetch models, verify, convert and try them, and only then put them in place."""
    directory = models or load_settings().models
    pull_with_progress(directory, names or (), manifest=manifest, allow_licenses=allow_license or (), revision=revision)


@models_app.command("use")
def use(
    names: Annotated[
        list[str], typer.Argument(help="A set (open-vocabulary, default), models, or a zip of folders of models.")
    ],
    manifest: _Manifest = None,
    allow_license: _Licenses = None,
    revision: _Revision = None,
) -> None:
    """Fetch models as by pull, and use them for questions and new jobs from now on.

    Other choices end. Settings of the environment that name a model go before.
    """
    from fastsplat.service.jobs.needed_models import choice_of
    from fastsplat.service.perception.models.model_manifest import DEFAULT

    settings = load_settings()
    entries: Sequence[ModelEntry] = ()
    if names != [DEFAULT]:
        entries = pull_with_progress(
            settings.models, names, manifest=manifest, allow_licenses=allow_license or (), revision=revision
        )
    choice = choice_of(entries, settings.models, built_in=manifest is None)
    with local_store() as store:
        store.models.choose(choice)
    for role, model in choice.items():
        still = "; the environment's stays" if role in settings.perception.model_fields_set else ""
        typer.echo(f"{role.replace('_', ' ')}: {model['name']}{still}")
    typer.echo(f"{'' if choice else 'the models of the settings: '}in use from the next question and job on")


def pull_with_progress(
    directory: Path,
    names: Sequence[str] = (),
    *,
    manifest: Path | None = None,
    allow_licenses: Sequence[str] = (),
    revision: str | None = None,
) -> Sequence[ModelEntry]:
    """Pulls models and unpacks zips with a line a model; returns the manifest's entries."""
    from fastsplat.service.perception.model_pull.model_archive import unpack
    from fastsplat.service.perception.model_pull.pull import pull as pull_models
    from fastsplat.service.perception.models.model_manifest import select_models

    archives = [name for name in names if name.endswith(".zip")]
    named = [name for name in names if name not in archives]
    with _progress() as (report, planned):
        for archive in archives:
            named += unpack(Path(archive), directory, report=report, manifest=manifest)
        pull_models(
            directory,
            named,
            report=report,
            planned=planned,
            manifest=manifest,
            allow_licenses=allow_licenses,
            revision=revision,
        )
        entries, said = select_models(named, manifest), list[str]()
        for entry in entries:
            if entry.role in ("image_text", "open_set_detector"):
                name = entry.name if manifest is None else f"{entry.adapter}:{entry.name}"
                said += _calibrated(entry.role, name, directory, report)
    for line in said:
        typer.echo(line)
    return entries


def _calibrated(role: str, name: str, models: Path, report: Callable[[Step], None]) -> Iterator[str]:
    """Measures what a model's scores mean, unless that is known; yields what was found."""
    from fastsplat.service.instances.naming.name_models import load_name_model, save_name_model
    from fastsplat.service.jobs.detector_calibration import calibrate_detector
    from fastsplat.service.jobs.looks_calibration import calibrate_image_text
    from fastsplat.service.perception.image_text import open_image_text
    from fastsplat.service.perception.model_pull.pull import Step
    from fastsplat.service.query.phrases.looks_files import load_calibration, save_calibration

    line, perception = name.rpartition(":")[2], load_settings().perception.model_copy(update={role: name})

    def tell(event: ProgressEvent) -> None:
        report(Step(line, event.message, round(100 * event.fraction), 100))

    model = open_image_text(perception, models) if role == "image_text" else None
    if (load_name_model(name, models) if model is None else load_calibration(model, models)) is not None:
        return
    try:
        if model is None:
            measured = calibrate_detector(perception, models, tell)
            save_name_model(measured, models)
            yield measured.summary
        else:
            calibration, common = calibrate_image_text(model, tell)
            save_calibration(calibration, common, models)
            yield calibration.summary
    except ModelUnavailableError as error:  # it suggests without
        yield f"{name} suggests names only: {error}"
    report(Step(line, "ready"))


@contextmanager
def _progress() -> Iterator[tuple[Callable[[Step], None], Callable[[ModelEntry], None]]]:
    """A line a model that says how far it is; yields what hears each step, and each model to fetch."""
    columns = (BarColumn(bar_width=12), TimeElapsedColumn(), TextColumn("{task.fields[model]}: {task.description}"))
    tasks: dict[str, TaskID] = {}
    with Progress(*columns) as progress:

        def report(step: Step) -> None:
            if step.model not in tasks:
                tasks[step.model] = progress.add_task("", model=step.model, total=None)
            if not progress.console.is_terminal and progress.tasks[tasks[step.model]].description != step.what:
                progress.console.print(f"{step.model}: {step.what}", soft_wrap=True, highlight=False)  # it draws no bar
            finished = step.what in ("ready", "already there")
            total, done = (1, 1) if finished else (step.total or None, step.done)
            progress.update(tasks[step.model], description=step.what, total=total, completed=done)

        def planned(entry: ModelEntry) -> None:
            said = [entry.license, size(entry.size) if entry.size else "size not known", *entry.commits]
            progress.console.print(f"{entry.name}: {', '.join(said)}", soft_wrap=True, highlight=False)

        yield report, planned
