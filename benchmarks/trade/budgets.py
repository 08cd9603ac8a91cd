"""Whether jobs end within their time budget: `python -m benchmarks.trade.budgets [--seconds 30 60 120]`.

Whole jobs through a worker process, as a user would post them: the table-top benchmark with its label maps, and the
demo's sample with its poses but without label maps, so that a detector runs. What counts is what the budget covers:
perception, training and export, by the stages' own clocks. Writes benchmarks/results/trade_budgets.json.
"""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.provenance import ROOT, begin, chosen_on, parser_of, write_results
from benchmarks.whole_jobs import run_job
from fastsplat.service.settings import Settings
from fastsplat_contract.jobs.operations import SceneOptions

_STAGES = ("perception", "training", "export")


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, nargs="*", default=[30.0, 60.0, 120.0])
    parser.add_argument("--data", nargs="*", default=["tabletop", "sample"])
    options = parser.parse_args()
    start = begin()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data_dir=Path(folder) / "data")
        for data in options.data:
            for seconds in options.seconds:
                rows.append({"data": data, "budget_s": seconds, **_job(_upload(data), seconds, settings)})
                print(json.dumps(rows[-1], ensure_ascii=False), flush=True)
    write_results("trade_budgets", start, options, chosen_on("tabletop", "test"), {"rows": rows})


def _upload(data: str) -> dict[str, bytes]:
    root = Path(os.environ["FASTSPLAT_TEST_DATA"]) / "tabletop" if data == "tabletop" else ROOT / "demo" / "sample"
    document = json.loads((root / "transforms.json").read_text())
    document.pop("split", None)
    files: dict[str, bytes] = {}
    for frame in document["frames"]:
        frame.pop("depth_path", None)
        if data == "sample":
            frame.pop("mask_path")
        for name in (frame["file_path"], frame.get("mask_path")):
            if name:
                files[name] = (root / name).read_bytes()
    if data == "sample":
        document.pop("labels")
    else:
        document["ply_file_path"] = "points3d.ply"
        files["points3d.ply"] = (root / "points3d.ply").read_bytes()
    return {"transforms.json": json.dumps(document).encode(), **files}


def _job(files: dict[str, bytes], seconds: float, settings: Settings) -> dict[str, Any]:
    job = run_job(files, SceneOptions(time_budget_s=seconds), settings)
    quality = job.quality
    stages = {stage: round(quality["stage_seconds"][stage], 2) for stage in _STAGES}
    actual = sum(stages.values())
    figures = {name: round(quality[name], 3) for name in ("psnr", "iterations", "gaussians") if name in quality}
    return {
        "actual_s": round(actual, 2),
        "error": round(actual / seconds - 1, 4),
        "stages": stages,
        **figures,
        "load": round(job.load, 1),
        "tradeoffs": quality["tradeoffs"],
    }


if __name__ == "__main__":
    main()
