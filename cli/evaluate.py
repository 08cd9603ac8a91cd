"""`fastsplat evaluate`: train on a data set's training split, score its test split, say all figures."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.settings import Settings, load_settings
from fastsplat.service.splatting.presets import PERCEPTION_PRESETS, PRESETS, with_preset
from fastsplat_contract.errors import InvalidInputError, NotFoundError, NotReadyError
from fastsplat_contract.operations import PresetName

_FIGURES = (
    "miou", "miou_micro", "miou_threshold", "boundary_iou", "pixel_accuracy", "localization",
    "localization_peak_in_mask", "ghost_rate", "mask3d_iou", "psnr", "ssim", "depth_error", "absent_auroc",
)  # fmt: skip

_Tell = Callable[[ProgressEvent], None]


def evaluate(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="transforms.json, COLMAP, LERF-OVS or 3D-OVS folder with images.")
    ],
    preset: Annotated[
        Literal[PresetName, "settings"],
        typer.Option(help="How much to spend; 'settings' takes FASTSPLAT_TRAINING__* as they are."),
    ] = "balanced",
    labels: Annotated[
        Literal["given", "detected"],
        typer.Option(help="Train on the data set's label maps, or on what the models find of its labels."),
    ] = "given",
    scene: Annotated[
        str, typer.Option(help="Score this trained scene instead: an id of the data folder, or an artefact's folder.")
    ] = "",
    json_file: Annotated[Path | None, typer.Option("--json", help="Write every figure to this file.")] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="Draw photo, truth, answer and error of every test view.")
    ] = None,
    keep: Annotated[Path | None, typer.Option(help="Write the trained scene to this new folder, for --scene.")] = None,
    time_budget: Annotated[float | None, typer.Option(min=1, help="Seconds of optimisation.")] = None,
    max_gaussians: Annotated[int | None, typer.Option(min=1, help="Hard budget.")] = None,
    device: Annotated[
        Literal["cpu", "cuda"] | None, typer.Option("--device", "--backend", help="Where to train and render.")
    ] = None,
    test_every: Annotated[
        int, typer.Option(min=2, help="One view in so many tests, if the data set has no split.")
    ] = 8,
    mask_label: Annotated[str, typer.Option(help="What binary masks show, for data sets that do not say.")] = "",
) -> None:
    """Train on the training split of a data set and score its test split.

    Training views never score, a missing prediction counts as zero, and whatever was not measured is null in the JSON
    with the reason beside it.
    """
    from fastsplat.service.evaluation.datasets import read_dataset  # loads torch, which `--help` can do without
    from fastsplat.service.evaluation.scene import evaluate_scene
    from fastsplat.service.evaluation.trial import train_on
    from fastsplat.service.perception.text import open_text_encoder
    from fastsplat.service.query import SceneIndex
    from fastsplat.service.scene import read_scene, write_scene

    _check_targets(json_file, pictures, keep)
    settings = _settings(preset, time_budget, max_gaussians, device)
    console = Console()
    with tempfile.TemporaryDirectory(prefix="fastsplat-") as work, _shown(console) as tell:
        tell(ProgressEvent("data set", 0.0, folder.name))
        dataset = read_dataset(folder, settings.capture, test_every=test_every, mask_label=mask_label)
        tell(ProgressEvent("data set", 1.0, f"{len(dataset.train)} views to train on, {len(dataset.test)} to test"))
        known: dict[str, Any] = {}
        if scene:
            artefact = _artefact(scene, settings)
            trained = read_scene(artefact)
            known = {"seconds": trained.quality.get("stage_seconds", {})}
        else:
            trial = train_on(dataset, settings, labels, Path(work), tell)
            trained, artefact = trial.scene, keep or Path(work) / "artefact"
            write_scene(trained, artefact)
            known = {"seconds": trial.seconds, "peak_mb": trial.peak_mb}
        size = sum(path.stat().st_size for path in artefact.iterdir())
        encoder = open_text_encoder(settings.perception.text_encoder, settings.models)
        index = SceneIndex(trained, encoder, settings.query)
        report = evaluate_scene(
            index,
            dataset,
            scene_bytes=size,
            progress=tell,
            watch=_painter(index, dataset.dictionary, pictures),
            **known,
        )
    written = report.to_json()
    written["settings"] = dict(trained.training)
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps(written, indent=1, allow_nan=False, ensure_ascii=False) + "\n")
    console.print(_table(folder.name, written))


def _settings(preset: str, time_budget: float | None, max_gaussians: int | None, device: str | None) -> Settings:
    settings = load_settings()
    training, perception = settings.training, settings.perception
    name: PresetName | None = next((known for known in PRESETS if known == preset), None)
    if name is not None:
        training = with_preset(training, name)
        perception = perception.model_copy(update=dict(PERCEPTION_PRESETS[name]))
    chosen = {"time_budget_s": time_budget, "max_gaussians": max_gaussians, "backend": device}
    training = training.model_copy(update={key: value for key, value in chosen.items() if value is not None})
    query = settings.query if device is None else settings.query.model_copy(update={"backend": device})
    return settings.model_copy(update={"training": training, "perception": perception, "query": query})


def _check_targets(json_file: Path | None, pictures: Path | None, keep: Path | None) -> None:
    """Before minutes of training, not after."""
    if json_file is not None and json_file.is_dir():
        raise InvalidInputError(f"{json_file} is a folder", field="--json", hint="Name a file.")
    if pictures is not None and pictures.exists() and not pictures.is_dir():
        raise InvalidInputError(f"{pictures} is no folder", field="--pictures", hint="Name a folder.")
    if keep is not None and keep.exists():
        raise InvalidInputError(
            f"{keep} exists", field="--keep", hint="Name a new folder; scenes are never overwritten."
        )


def _artefact(scene: str, settings: Settings) -> Path:
    """Folder of a scene's arrays: of a path, or of the current version of an id."""
    if (Path(scene) / "scene.json").is_file():
        return Path(scene)
    from fastsplat.service.store import open_store

    if not settings.data_dir.is_dir():
        raise NotFoundError(
            f"{scene} is no scene folder, and there is no data folder {settings.data_dir}",
            field="--scene",
            hint="Name an artefact's folder, or point FASTSPLAT_DATA_DIR at the service's data.",
        )
    store = open_store(settings.data_dir, settings.database_url, settings.artefacts)
    try:
        state, version, _ = store.rows.version(scene)
        if state != "READY":
            raise NotReadyError(f"the scene {scene} is {state}", field="--scene", hint="Wait for its training to end.")
        return store.blobs.version(scene, version) / "artefact"
    finally:
        store.close()


def _painter(index: Any, dictionary: Any, folder: Path | None) -> Callable[[Any, Any], None]:
    import numpy as np
    from PIL import Image

    from fastsplat.service.evaluation.pictures import label_sheet, query_sheet

    def paint(view: Any, score: Any) -> None:
        if folder is None or score.rendered is None:
            return
        if view.labels is not None:
            sheet = label_sheet(view, score, dictionary)
        else:
            answers = [(query.text, index.ask([query.text])[0]) for query in view.queries]
            sheet = query_sheet(view, [(text, index.mask2d(answer, view.posed).mask) for text, answer in answers])
        target = folder / Path(view.name.replace("/", "_")).with_suffix(".jpg")
        folder.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.ascontiguousarray(sheet)).save(target, quality=90)

    return paint


@contextmanager
def _shown(console: Console) -> Iterator[_Tell]:
    """One bar a stage."""
    columns = (
        TextColumn("{task.fields[stage]:<11}"),
        BarColumn(bar_width=24),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    tasks: dict[str, TaskID] = {}
    with Progress(*columns, console=console) as bars:

        def tell(event: ProgressEvent) -> None:
            if event.stage not in tasks:
                for earlier in tasks.values():
                    bars.update(earlier, completed=1.0)
                    bars.stop_task(earlier)
                tasks[event.stage] = bars.add_task("", stage=event.stage, total=1.0)
            psnr = f", {event.metrics['psnr']:.1f} dB" if "psnr" in event.metrics else ""
            bars.update(tasks[event.stage], completed=event.fraction, description=f"{event.message}{psnr}")

        yield tell


def _table(name: str, written: dict[str, Any]) -> Table:
    table = Table(title=f"{name}: {written['dataset']['test_views']} test views, {written['gaussians']} Gaussians")
    for heading in ("figure", "value", "95 % interval", ""):
        table.add_column(heading, no_wrap=heading != "")
    for key in _FIGURES:
        interval = written["intervals"].get(key)
        table.add_row(
            key,
            "-" if written[key] is None else f"{written[key]:.4f}",
            "" if interval is None or None in interval else f"{interval[0]:.4f} .. {interval[1]:.4f}",
            written["reasons"].get(key, ""),
        )
    for label, iou in sorted(written["miou_per_class"].items(), key=lambda item: -1 if item[1] is None else item[1]):
        table.add_row(f"  {label}", "-" if iou is None else f"{iou:.4f}", "", "")
    for stage, taken in written["seconds"].items():
        table.add_row(f"{stage}, s", f"{taken:.1f}", "", "")
    return table
