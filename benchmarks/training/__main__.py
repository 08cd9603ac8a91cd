"""Trains a data set for a given time; writes PSNR against seconds as JSON.

    python -m benchmarks.training DATA [--seconds 240] [--gaussians 40000] [--split test]

DATA is a folder with a nerfstudio `transforms.json` whose frames may name id masks (`mask_path`, with `labels` beside
the frames) and with `points3d.ply`. Seconds are those of optimisation, the evaluations along the way included. Views of
the training split are measured, as rates are to be chosen by those; with `--split test` the test views. With
`--light 1 2` there is a run for each of these seeds, of training photos in drawn light (`drawn_light`).
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.evaluation.validation_split import Split
from benchmarks.provenance import RESULTS, begin, chosen_on, parser_of, peak_megabytes, provenance, write_json
from benchmarks.splits import HELD_OUT, add_split, results_file, with_split
from benchmarks.training.drawn_light import in_drawn_light
from benchmarks.training.posed_folder import load_posed_folder
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.perception.results import Labelling
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import TrainingSettings


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--seconds", type=float, default=240.0)
    parser.add_argument("--gaussians", type=int, default=40_000)
    add_split(parser)
    parser.add_argument("--evaluations", type=int, default=24)
    parser.add_argument("--light", type=int, nargs="*", default=[], metavar="SEED", help="light is drawn by these")
    parser.add_argument("--colors-alone", action="store_true", help="without labels and codes")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=JSON", help="other training settings")
    options = parser.parse_args()
    settings = TrainingSettings.model_validate(
        {
            "time_budget_s": options.seconds,
            "max_gaussians": options.gaussians,
            "held_out_every": HELD_OUT,
            "evaluations": options.evaluations,
            "iterations": 10**7,
            **{name: json.loads(value) for name, value in (item.split("=", 1) for item in options.set)},
        }
    )
    for light in options.light or [None]:
        with tempfile.TemporaryDirectory() as work:
            result = _measure(options.data, settings, options.split, options.colors_alone, light, Path(work))
        drawn = "" if light is None else f"_light{light}"
        name = results_file(f"training_{options.data.resolve().name}_{options.seconds:.0f}s{drawn}", options.split).stem
        write_json(RESULTS / f"{name}.json", result)
        print(json.dumps({key: value for key, value in result.items() if key not in ("curve", "settings")}, indent=1))


def _measure(
    folder: Path, settings: TrainingSettings, split: Split, colors_alone: bool, light: int | None, work: Path
) -> dict[str, Any]:
    capture, labelling = load_posed_folder(folder)
    if colors_alone:
        labelling = Labelling(Dictionary(()), ())
    capture, labelling = with_split(capture, labelling, capture.test_names, split)
    if light is not None:
        capture = in_drawn_light(capture, light, work)
    curve: list[dict[str, float]] = []

    def listen(event: ProgressEvent) -> None:
        if "psnr" not in event.metrics:
            return
        names = ("elapsed_s", "iteration", "gaussians", "loss", "psnr")
        point = {key: round(event.metrics[key], 5) for key in names}
        if not curve or curve[-1]["psnr"] != point["psnr"]:  # reports repeat the figure until it is measured again
            curve.append(point)
            print("  ".join(f"{key} {value:g}" for key, value in point.items()), flush=True)

    start, cpu_before = begin(), time.process_time()
    trained = train(capture, labelling, settings, listen)
    cpu, peak_mb = time.process_time() - cpu_before, peak_megabytes()
    chosen = chosen_on(folder.resolve().name, split)
    about = provenance(start, settings=settings.model_dump(mode="json"), chosen_on=chosen)
    from benchmarks.evaluation.held_out_views import (
        evaluate_views,  # its libraries are not training's, and not in its peak
    )

    report = evaluate_views(
        trained.gaussians, trained.head, capture, labelling, trained.held_out,
        max_side=settings.max_side, backend=settings.backend,
    )  # fmt: skip
    return {
        "data": folder.resolve().name,
        **about,
        "cpu_seconds": round(cpu, 1),
        "peak_mb": round(peak_mb, 1),
        **{key: round(value, 4) for key, value in trained.quality.items()},
        "mean_iou": round(report.mean_iou, 4),
        "iou": {label: round(value, 3) for label, value in report.iou.items()},
        "split": split,
        "light": light,
        "warnings": list(trained.warnings),
        "curve": curve,
    }


if __name__ == "__main__":
    main()
