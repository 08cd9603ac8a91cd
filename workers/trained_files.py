"""Training results as files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from fastsplat.service.scene.types import Evidence, Gaussians, SemanticHead
from fastsplat.service.splatting.types import TrainedSplats
from fastsplat.workers.results import intact


def save_trained(trained: TrainedSplats, folder: Path) -> None:
    """Writes a training result: `arrays.npz` and `report.json`."""
    arrays = {**vars(trained.gaussians), "weight": trained.head.weight, "bias": trained.head.bias}
    if trained.evidence is not None:
        arrays |= {f"evidence.{name}": array for name, array in vars(trained.evidence).items()}
    np.savez(folder / "arrays.npz", **arrays)
    report = {name: getattr(trained, name) for name in ("held_out", "photometric", "warnings")}
    report |= {"quality": dict(trained.quality)}
    (folder / "report.json").write_text(json.dumps(report, default=float))


def load_trained(folder: Path) -> TrainedSplats:
    """Reads the output of `save_trained`."""
    with intact(folder / "arrays.npz"), np.load(folder / "arrays.npz", allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
        head = SemanticHead(arrays.pop("weight"), arrays.pop("bias"))
        parts = {name.partition(".")[2]: arrays.pop(name) for name in list(arrays) if name.startswith("evidence.")}
        evidence = Evidence(**parts) if parts else None
        gaussians = Gaussians(**arrays)
    with intact(folder / "report.json"):
        report = json.loads((folder / "report.json").read_text())
        photometric = {name: tuple(row) for name, row in report["photometric"].items()}
        held_out, warnings = tuple(report["held_out"]), tuple(report["warnings"])
        return TrainedSplats(gaussians, head, report["quality"], held_out, evidence, photometric, warnings)
