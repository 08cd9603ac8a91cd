"""What a person waits for on the page: `python -m benchmarks.page`.

The trained sample of `make demo`, and a made scene of so many Gaussians; each in Debian's Chromium with software WebGL,
and without WebGL, where the server draws. Times are since the navigation began, in a new profile, of a server on the
same machine; what the browser computes it computes on the same CPUs. Rows go to benchmarks/results/page.json.
"""

from __future__ import annotations

import dataclasses
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from benchmarks.page.measured_visit import Visited, opened, visit
from benchmarks.provenance import MADE_FAST_HERE, ROOT, begin, parser_of, write_results
from benchmarks.serve.api_process import Api
from benchmarks.serve.stored_scenes import add_scene, room
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import open_store
from fastsplat_client import Client

_SAMPLE = ROOT / "demo-output" / "service"


def main() -> None:
    """Visit every scene with and without WebGL, print the rows, write the file."""
    parser = parser_of(__doc__)
    parser.add_argument("--sample", type=Path, default=_SAMPLE, help="data folder with the trained sample")
    parser.add_argument("--gaussians", type=int, default=1_000_000, help="of the made scene; 0: none")
    parser.add_argument("--seconds", type=float, default=10.0, help="how long to orbit")
    arguments = parser.parse_args()
    models = Path(os.environ.get("FASTSPLAT_MODELS", ROOT / ".models")).resolve()
    if not (arguments.sample / "fastsplat.sqlite").is_file():
        parser.error(f"{arguments.sample} has no trained sample: run make demo first, or name a folder by --sample")
    start = begin()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="fastsplat-page-") as folder:
        sample = Settings(data_dir=Path(folder) / "sample", models=models)
        shutil.copytree(arguments.sample, sample.data_dir)
        rows += _rows("sample", sample, "banana", arguments.seconds)
        if arguments.gaussians:
            made = Settings(data_dir=Path(folder) / "made", models=models)
            store = open_store(made.data_dir, made.database_url)
            add_scene(store, room(arguments.gaussians, models))
            rows += _rows("made", made, "teddy bear", arguments.seconds)
    write_results("page", start, arguments, MADE_FAST_HERE, {"rows": rows})


def _rows(name: str, settings: Settings, text: str, seconds: float) -> list[dict[str, Any]]:
    """A scene with and without WebGL."""
    rows = []
    with Api(settings, {}) as api, sync_playwright() as playwright:
        url = f"http://127.0.0.1:{api.http_port}"
        with Client(url, key=api.key) as client:
            scene = next(iter(client.scenes()))
        for webgl in (True, False):
            with opened(playwright, webgl=webgl) as browser:
                visited = visit(browser, url, api.key, scene.id, text, seconds)
            row = {"scene": name, "gaussians": scene.gaussians, "webgl": webgl, **_rounded(visited)}
            print(row, flush=True)
            rows.append(row)
    return rows


def _rounded(visited: Visited) -> dict[str, Any]:
    values = dataclasses.asdict(visited)
    return {name: round(value, 3) if isinstance(value, float) else value for name, value in values.items()}


if __name__ == "__main__":
    main()
