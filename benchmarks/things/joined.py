"""Photos that join a finished scene, against a scene that was trained with all of them from the start.

    python -m benchmarks.things.joined [NAME ...] [--split test] [--photos 5] [--iterations 2500] --keep FOLDER

NAME is `sample`, `tabletop` or `plush` (without truth: seconds alone), see `benchmarks.things`. Of the training views
`--photos`, evenly spread, join the scene of the others with the poses of the data set, as a job lets them: models look
at them, what they show is trained, and their masks say of which things it is. Every scene is measured by the views of
the split: `before`, `joined` and `anew`. `looking`, `training` and `merging` are the seconds of joining alone, with the
machine's load at their begin: CPU seconds of a busy machine are more than those of an idle one.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.provenance import RESULTS, begin, chosen_on, parser_of, provenance, write_json
from benchmarks.rooms.__main__ import with_things
from benchmarks.splits import add_split, results_file
from benchmarks.things.__main__ import discovery_data
from benchmarks.things.discovered import settings_by_steps, timed, trained_scene
from fastsplat.service.capture.types import Capture, View
from fastsplat.service.common.progress import silent
from fastsplat.service.evaluation.datasets.training import subset
from fastsplat.service.evaluation.datasets.types import Dataset
from fastsplat.service.evaluation.scene_evaluation import evaluate_scene
from fastsplat.service.joined_things import look_at_joined, with_joined_things
from fastsplat.service.perception.labelling import label_capture
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.perception.types import Labelling
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.types import Scene
from fastsplat.service.settings import Settings
from fastsplat.service.train_more import merged_scene, train_further

_NAMES = ("sample", "tabletop", "plush")
_FIGURES = ("psnr", "clicks_miou", "things_recall_50", "things_precision")


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("names", nargs="*", choices=[*_NAMES, []], default=[])
    parser.add_argument("--photos", type=int, default=5)
    parser.add_argument("--iterations", type=int, default=2500)
    parser.add_argument("--gaussians", type=int, default=30_000)
    parser.add_argument("--keep", type=Path, required=True, help="folder of trained scenes")
    add_split(parser)
    options = parser.parse_args()
    settings = settings_by_steps(options.iterations, options.gaussians)
    out = results_file("joined", options.split)
    for name in options.names or _NAMES:
        start = begin()
        row = _row(name, settings, options)
        about = provenance(start, settings=options, chosen_on=chosen_on(name, options.split))
        document = json.loads(out.read_text()) if out.is_file() else {"rows": {}}
        document["rows"][name] = {**row, "provenance": about}
        write_json(RESULTS / out.name, document)
        print(f"{name}: {json.dumps(row)}", flush=True)


def _row(name: str, settings: Settings, options: argparse.Namespace) -> dict[str, Any]:
    keep = options.keep / options.split
    with tempfile.TemporaryDirectory(prefix="fastsplat-") as work:
        dataset, capture = discovery_data(name, Path(work), keep, settings.capture, options.split)
        names = [view.posed.name for view in capture.views]
        step = len(names) // options.photos
        new = names[step // 2 :: step][: options.photos]
        few = subset(capture, tuple(each for each in names if each not in new))
        looked = label_capture(
            replace(few, given_labels=None), settings.perception, settings.models, (), silent, masks=True
        )
        before = with_things(trained_scene(keep / f"{name}-few", few, settings), few, looked, settings)
        before = replace(before, quality={**before.quality, "label_source": "detected"})
        views = tuple(view for view in capture.views if view.posed.name in new)
        joined, row = _joined(before, replace(capture, views=(*few.views, *views)), views, settings)
        row |= {"views": len(names), "photos": len(new), "gaussians": len(joined.gaussians)}
        if dataset is None:
            return row
        row["before"], row["joined"] = (_figures(each, dataset, settings) for each in (before, joined))
        whole = trained_scene(keep / name, capture, settings)
        looked = label_capture(
            replace(capture, given_labels=None), settings.perception, settings.models, (), silent, masks=True
        )
        row["anew"] = _figures(with_things(whole, capture, looked, settings), dataset, settings)
        return row


def _joined(before: Scene, capture: Capture, views: Sequence[View], settings: Settings) -> tuple[Scene, dict[str, Any]]:
    """The scene after the last views of the capture have joined, and what that took."""
    load, names = round(os.getloadavg()[0], 1), [view.posed.name for view in views]
    looked, looking = timed(lambda: look_at_joined(before, views, settings, silent))
    assert looked is not None
    labelling: Labelling = looked
    continued, training = timed(lambda: train_further(before, capture, settings, silent, joined=names))

    def merge() -> Scene:
        merged = merged_scene(before, before, continued)
        assert merged is not None and continued.changed is not None
        born = np.arange(len(merged.gaussians)) >= len(before.gaussians)
        placed = replace(merged, cameras=(*merged.cameras, *(view.posed for view in views)))
        return with_joined_things(placed, views, labelling, continued.changed, born, settings)

    scene, merging = timed(merge)
    assert before.things is not None and scene.things is not None and continued.changed is not None
    stages = {"looking": looking, "training": training, "merging": merging}
    return scene, {
        "load": load,
        **{f"{stage}_{key}": value for stage, seconds in stages.items() for key, value in seconds.items()},
        "new_things": len(scene.things.table) - len(before.things.table),
        "unchanged": int((~continued.changed).sum()),
    }


def _figures(scene: Scene, dataset: Dataset, settings: Settings) -> dict[str, float]:
    encoder = open_text_encoder(settings.perception.text_encoder, settings.models)
    report = evaluate_scene(SceneIndex(scene, encoder, settings.query), dataset, samples=0)
    return {name: round(float(report.value(name)), 4) for name in _FIGURES}


if __name__ == "__main__":
    _main()
