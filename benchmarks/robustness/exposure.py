"""Measures what photos of different exposure and white balance cost, and what correcting them brings back.

    python -m benchmarks.robustness.exposure [--split test] [--steps 800] [--set NAME=JSON ...] [--out FOLDER]

The training photos of tabletop (FASTSPLAT_TEST_DATA) get a gain of the light drawn evenly from ±1.2 EV and gains of
red, green and blue from ±6 %, by seed; values beyond white are lost, as in a photo. A point's color is what three
photos drawn for it make of it on the average, as structure from motion would. Measured views stay as they are;
`psnr_cc` is measured after their colors were aligned, as nobody can know the exposure of the scene. They are views of
the training split, by which settings are to be chosen, unless `--split test` says otherwise.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from benchmarks.provenance import begin, chosen_on, provenance, write_json
from benchmarks.splits import HELD_OUT, add_split
from benchmarks.trade.bench_captures import BenchData, load_data
from fastsplat.service.capture.image_io import load_rgb, save_rgb
from fastsplat.service.capture.types import Capture
from fastsplat.service.common.progress import silent
from fastsplat.service.evaluation.depth_error import depth_errors
from fastsplat.service.evaluation.held_out_views import evaluate_views
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.photometric import channel_evs, from_light, to_light, zero_mean
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.train import train
from fastsplat.service.splatting.types import TrainedSplats

_GAIN_EV, _BALANCE, _PHOTOS_A_POINT = 1.2, 0.06, 3
_DEPTH_UNIT = 1e-4  # of tabletop's depth maps, metres


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default="tabletop", choices=("tabletop", "sample"))
    parser.add_argument("--steps", type=int, default=800)
    parser.add_argument("--side", type=int, default=240)
    parser.add_argument("--gaussians", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0, help="of the drawn gains; the training's stays 0")
    add_split(parser)
    parser.add_argument("--rows", nargs="*", default=["clean off", "clean on", "perturbed off", "perturbed on"])
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=JSON", help="other training settings")
    parser.add_argument("--out", type=Path, help="a folder; without it nothing is written")
    options = parser.parse_args()
    torch.set_num_threads(1)
    changes = {name: json.loads(value) for name, value in (item.split("=", 1) for item in options.set)}
    settings = TrainingSettings.model_validate(
        {
            "time_budget_s": None,
            "iterations": options.steps,
            "max_side": options.side,
            "max_gaussians": options.gaussians,
            "held_out_every": HELD_OUT,
            **changes,
        }
    )
    data, start = load_data(options.data, options.split), begin()
    rows: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        perturbed, drawn = perturb(data, Path(folder), options.seed)
        for name in options.rows:
            capture = perturbed if name.startswith("perturbed") else data.capture
            row_settings = settings.model_copy(update={"photometric": name.split()[1]})
            truth = drawn if name.startswith("perturbed") else torch.zeros_like(drawn)
            rows[name] = _measure(replace(data, capture=capture), row_settings, truth)
            print(name, json.dumps(rows[name]), flush=True)
    result = {
        **provenance(
            start, settings=settings.model_dump(mode="json"), chosen_on=chosen_on(options.data, options.split)
        ),
        "split": options.split,
        "rows": rows,
    }
    if options.out:
        write_json(options.out / f"exposure_{options.data}_{options.split}.json", result)


def perturb(data: BenchData, folder: Path, seed: int) -> tuple[Capture, torch.Tensor]:
    """The capture with training photos of other exposures, written to `folder`; and their corrections [V, 3], of mean
    zero."""
    generator, capture = np.random.default_rng(seed), data.capture
    count = len(data.train)
    balance = np.log2(generator.uniform(1 - _BALANCE, 1 + _BALANCE, (count, 3)))
    evs = torch.from_numpy(generator.uniform(-_GAIN_EV, _GAIN_EV, (count, 1)) + balance)
    views = list(capture.views)
    for number, position in enumerate(data.train):
        pixels = torch.tensor(load_rgb(views[position].image_path)).double() / 255
        path = folder / f"{position:05d}.png"
        save_rgb(_exposed(pixels, evs[number]), path)
        views[position] = replace(views[position], image_path=path)
    colors = torch.tensor(capture.point_colors).double() / 255
    shown = generator.integers(count, size=(len(colors), _PHOTOS_A_POINT))
    mixed = np.stack([_exposed(colors, evs[column]) for column in shown.T]).mean(axis=0)
    corrections = torch.stack([evs[:, 1], evs[:, 0] - evs[:, 1], evs[:, 2] - evs[:, 1]], dim=1)
    perturbed = replace(capture, views=tuple(views), point_colors=mixed.round().astype(np.uint8))
    return perturbed, zero_mean(corrections)


def _exposed(stored: torch.Tensor, evs: torch.Tensor) -> NDArray[np.uint8]:
    """By the powers themselves, not by what the training uses in their place."""
    exposed = from_light(to_light(stored) * torch.exp2(evs)).clamp(0, 1)
    return (exposed * 255).round().to(torch.uint8).numpy()


def _measure(data: BenchData, settings: TrainingSettings, truth: torch.Tensor) -> dict[str, float]:
    cpu = time.process_time()
    trained = train(data.capture, data.truth, settings, silent)
    cpu = time.process_time() - cpu
    report = evaluate_views(trained.gaussians, trained.head, data.capture, data.truth, trained.held_out)
    figures = {
        "psnr": report.psnr,
        "psnr_cc": report.psnr_cc,
        "ssim": report.ssim,
        "miou": report.mean_iou,
        **_depth_figures(trained, data),
        **_correction_errors(trained, data, truth),
        "cpu_s": cpu,
        "steps": trained.quality["iterations"],
    }
    return {name: round(value, 4) for name, value in figures.items()}


def _depth_figures(trained: TrainedSplats, data: BenchData) -> dict[str, float]:
    """Mean relative error of the expected depth over the test views, and the median's."""
    means, medians, splats = [], [], splats_of(trained.gaussians)
    for position in data.test:
        posed = data.capture.views[position].posed
        path = data.capture.views[position].image_path.parents[1] / "depth" / f"{Path(posed.name).stem}.png"
        if not path.is_file():
            return {}
        true_z = np.asarray(Image.open(path)).astype(np.float64) * _DEPTH_UNIT
        drawn = rasterize(splats, torch.from_numpy(posed.camera_from_world()).float(), posed.camera)
        z = torch.where(drawn.alpha >= 0.5, drawn.depth / drawn.alpha.clamp_min(1e-6), 0.0).detach().numpy()
        errors = depth_errors(z, true_z)
        if errors is not None:
            means.append(errors.abs_rel)
            medians.append(errors.median_rel)
    return {"depth_error": float(np.mean(means)), "depth_median": float(np.mean(medians))}


def _correction_errors(trained: TrainedSplats, data: BenchData, truth: torch.Tensor) -> dict[str, float]:
    """Root mean square of what the corrections miss of the drawn ones, EV: of the exposure, of channels against it."""
    corrections: Mapping[str, tuple[float, float, float]] = trained.photometric
    if not corrections:
        return {}
    rows = torch.tensor([corrections[data.capture.views[position].posed.name] for position in data.train])
    error = channel_evs(rows.double()) - channel_evs(truth.double())
    common = error.mean(dim=1, keepdim=True)
    return {
        "exposure_rms_ev": float((common**2).mean().sqrt()),
        "balance_rms_ev": float(((error - common) ** 2).mean().sqrt()),
    }


if __name__ == "__main__":
    main()
