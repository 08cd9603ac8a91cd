"""`fastsplat evaluate`: train on a data set's training split, measure on its test split, report every figure."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from fastsplat.cli.settings import load_settings
from fastsplat.service.common.optional_packages import TORCHMETRICS, needed
from fastsplat.service.common.progress import ProgressEvent
from fastsplat_contract.errors import InvalidInputError, NotFoundError, NotReadyError
from fastsplat_contract.operations import PresetName

if TYPE_CHECKING:  # these load torch, which `--help` and a refusal can do without
    from fastsplat.service.evaluation.datasets.types import Dataset
    from fastsplat.service.evaluation.evaluation_report import Report, RunCost
    from fastsplat.service.evaluation.types import ViewPrediction
    from fastsplat.service.scene.types import Scene
    from fastsplat.service.settings import Settings

Listener = Callable[[ProgressEvent], None]

Folder = Annotated[
    Path, typer.Argument(metavar="DIR", help="transforms.json, COLMAP, LERF-OVS or 3D-OVS folder with images.")
]
Preset = Annotated[
    Literal[PresetName, "settings"],
    typer.Option(help="How much to spend; 'settings' takes FASTSPLAT_TRAINING__* as they are."),
]
Labels = Annotated[
    Literal["given", "detected", "discovered", "default"],
    typer.Option(
        help="Train on the data set's label maps; on what the models find of its labels; without any, so that things "
        "are discovered; or as a job does that is given photos and no names."
    ),
]
StoredScene = Annotated[
    str, typer.Option(help="Measure this trained scene instead: an id of the data folder, or an artefact's folder.")
]
JsonFile = Annotated[Path | None, typer.Option("--json", help="Write every figure to this file.")]
Pictures = Annotated[Path | None, typer.Option(help="Draw photo, truth, prediction and errors of every test view.")]
Keep = Annotated[Path | None, typer.Option(help="Write the trained scene to this new folder, for --scene.")]
TimeBudget = Annotated[float | None, typer.Option(min=1, help="Seconds of optimization.")]
MaxGaussians = Annotated[int | None, typer.Option(min=1, help="Hard budget.")]
Device = Annotated[
    Literal["cpu", "cuda"] | None, typer.Option("--device", "--backend", help="Where to train and render.")
]
TestEvery = Annotated[int, typer.Option(min=2, help="One view in so many tests, if the data set has no split.")]
Measured = Annotated[
    Literal["test", "validation"],
    typer.Option("--split", help="Measure some of the training views in place of the test views, to choose settings."),
]
MaskLabel = Annotated[str, typer.Option(help="What binary masks show, for data sets that do not say.")]


def evaluate(
    folder: Folder,
    preset: Preset = "balanced",
    labels: Labels = "given",
    scene: StoredScene = "",
    json_file: JsonFile = None,
    pictures: Pictures = None,
    keep: Keep = None,
    time_budget: TimeBudget = None,
    max_gaussians: MaxGaussians = None,
    device: Device = None,
    test_every: TestEvery = 8,
    mask_label: MaskLabel = "",
    split: Measured = "test",
) -> None:
    """Train on the training split of a data set and measure on its test split.

    No view of the training split is measured, a missing prediction counts as zero, and whatever was not measured is
    null in the JSON with the reason beside it.
    """
    _check_paths(folder, json_file, pictures, keep)
    with needed(TORCHMETRICS, "Measuring", field="", where="where fastsplat evaluate runs"):
        distribution("torchmetrics")  # is there, and is not loaded: the training's peak memory would count it
    from fastsplat.service.planning.presets import apply_preset, override_training

    settings = _with_device(load_settings(), device)
    name = None if preset == "settings" else preset
    settings = override_training(apply_preset(settings, name), max_gaussians=max_gaussians)
    if time_budget is not None:
        settings = settings.model_copy(update={"training": settings.training.ending_after(time_budget)})
    stored = _stored_artefact(scene, settings) if scene else None

    from fastsplat.service.evaluation.datasets.reading import read_dataset

    console = Console()
    with tempfile.TemporaryDirectory(prefix="fastsplat-") as work, _progress_bars(console) as listen:
        listen(ProgressEvent("data set", 0.0, folder.name))
        dataset = read_dataset(folder, settings.capture, test_every=test_every, mask_label=mask_label, split=split)
        views = f"{len(dataset.train)} training views, {len(dataset.test)} {split} views"
        listen(ProgressEvent("data set", 1.0, views))
        if stored is not None:
            subject = _read(stored)
        else:
            subject = _train(dataset, settings, Path(work), listen, labels=labels, preset=name, keep=keep)
        report = _measure(subject, dataset, settings, listen, pictures)
    written = {**report.to_json(), "settings": dict(subject.scene.training)}
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps(written, indent=1, allow_nan=False, ensure_ascii=False) + "\n")
    console.print(_table(folder.name, report))


@dataclass(frozen=True)
class _Subject:
    """The scene that is measured, and what it cost."""

    scene: Scene
    cost: RunCost


def _check_paths(folder: Path, json_file: Path | None, pictures: Path | None, keep: Path | None) -> None:
    """Refuse at once, not after seconds of imports or minutes of training."""
    if not folder.is_dir():
        raise NotFoundError(f"there is no folder {folder}", field="DIR", hint="Name a data set's folder.")
    if json_file is not None and json_file.is_dir():
        raise InvalidInputError(f"{json_file} is a folder", field="--json", hint="Name a file.")
    if pictures is not None and pictures.exists() and not pictures.is_dir():
        raise InvalidInputError(f"{pictures} is no folder", field="--pictures", hint="Name a folder.")
    if keep is not None and keep.exists():
        raise InvalidInputError(
            f"{keep} exists", field="--keep", hint="Name a new folder; scenes are never overwritten."
        )


def _with_device(settings: Settings, device: str | None) -> Settings:
    if device is None:
        return settings
    from fastsplat.service.planning.presets import override_training

    query = settings.query.model_copy(update={"backend": device})
    return override_training(settings.model_copy(update={"query": query}), backend=device)


def _stored_artefact(scene: str, settings: Settings) -> Path:
    """Folder of a scene's arrays: of a path, or of the current version of an id."""
    if (Path(scene) / "scene.json").is_file():
        return Path(scene)
    if not settings.data_dir.is_dir():
        raise NotFoundError(
            f"{scene} is no scene folder, and there is no data folder {settings.data_dir}",
            field="--scene",
            hint="Name an artefact's folder, or point FASTSPLAT_DATA_DIR at the service's data.",
        )
    from fastsplat.service.store.store import open_store

    store = open_store(settings.data_dir, settings.database_url, settings.artefacts)
    try:
        state, version, _ = store.scenes.current_version(scene)
        if state != "READY":
            raise NotReadyError(f"the scene {scene} is {state}", field="--scene", hint="Wait for its training to end.")
        return store.blobs.version(scene, version) / "artefact"
    finally:
        store.close()


def _read(artefact: Path) -> _Subject:
    from fastsplat.service.evaluation.evaluation_report import RunCost
    from fastsplat.service.scene.scene_files import read_scene

    scene = read_scene(artefact)
    return _Subject(scene, RunCost(scene.quality.get("stage_seconds", {}), _folder_bytes(artefact)))


def _train(
    dataset: Dataset,
    settings: Settings,
    work: Path,
    listen: Listener,
    *,
    labels: Literal["given", "detected", "discovered", "default"],
    preset: PresetName | None,
    keep: Path | None,
) -> _Subject:
    from fastsplat.service.evaluation.train_eval import train_on_split
    from fastsplat.service.scene.scene_files import write_scene

    trained = train_on_split(dataset, settings, work, listen, labels=labels, preset=preset)
    from fastsplat.service.evaluation.evaluation_report import (
        RunCost,  # the libraries of metrics are not in the training's peak memory
    )

    artefact = keep or work / "artefact"
    write_scene(trained.scene, artefact)
    return _Subject(trained.scene, RunCost(trained.seconds, _folder_bytes(artefact), trained.peak_mb))


def _folder_bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir())


def _measure(
    subject: _Subject, dataset: Dataset, settings: Settings, listen: Listener, pictures: Path | None
) -> Report:
    from fastsplat.service.evaluation.scene_evaluation import evaluate_scene
    from fastsplat.service.perception.lexicon.open_lexicon import find_lexicon
    from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
    from fastsplat.service.query.scene_index import SceneIndex

    encoder = open_text_encoder(settings.perception.text_encoder, settings.models)
    lexicon = find_lexicon(settings.perception.lexicon, settings.models)
    index = SceneIndex(subject.scene, encoder, settings.query, lexicon=lexicon)

    def draw(view: ViewPrediction) -> None:
        if pictures is not None and view.rgb is not None:
            _draw(view, pictures)

    return evaluate_scene(index, dataset, cost=subject.cost, progress=listen, on_view=draw)


def _draw(view: ViewPrediction, folder: Path) -> None:
    import numpy as np
    from PIL import Image

    from fastsplat.service.evaluation.contact_sheets import label_sheet, query_sheet

    sheet = query_sheet(view) if view.truth.labels is None else label_sheet(view)
    target = folder / Path(view.truth.name.replace("/", "_")).with_suffix(".jpg")
    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.ascontiguousarray(sheet)).save(target, quality=90)


@contextmanager
def _progress_bars(console: Console) -> Iterator[Listener]:
    """One bar for each stage."""
    columns = (
        TextColumn("{task.fields[stage]:<11}"),
        BarColumn(bar_width=24),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    tasks: dict[str, TaskID] = {}
    with Progress(*columns, console=console) as bars:

        def listen(event: ProgressEvent) -> None:
            if event.stage not in tasks:
                for earlier in tasks.values():
                    bars.update(earlier, completed=1.0)
                    bars.stop_task(earlier)
                tasks[event.stage] = bars.add_task("", stage=event.stage, total=1.0)
            psnr = f", {event.metrics['psnr']:.1f} dB" if "psnr" in event.metrics else ""
            bars.update(tasks[event.stage], completed=event.fraction, description=f"{event.message}{psnr}")

        yield listen


def _table(name: str, report: Report) -> Table:
    test_views = report.dataset["test_views"]
    table = Table(title=f"{name}: {test_views} test views, {report.gaussians} Gaussians; ↑ higher is better, ↓ lower")
    for heading in ("metric", "value", "unit", "95 % interval", ""):
        table.add_column(heading, no_wrap=heading != "")
    for figure in report.figures.values():
        if figure.metric.headline:
            table.add_row(
                f"{figure.metric.name} {'↑' if figure.metric.higher_is_better else '↓'}",
                _number(figure.value),
                figure.metric.unit,
                "" if figure.interval is None else f"{figure.interval[0]:.4f} .. {figure.interval[1]:.4f}",
                figure.reason or (f"{len(figure.skipped)} views skipped" if figure.skipped else ""),
            )
    by_label = report.figures["miou"].per_label
    for label, iou in sorted(by_label.items(), key=lambda item: -1.0 if math.isnan(item[1]) else item[1]):
        table.add_row(f"  {label}", _number(iou), "", "", "")
    for stage, seconds in report.seconds.items():
        table.add_row(stage, f"{seconds:.1f}", "s", "", "")
    return table


def _number(value: float | None) -> str:
    return "-" if value is None or math.isnan(value) else f"{value:.4f}"
