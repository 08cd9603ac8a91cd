"""What a person waits for on the page: `python -m benchmarks.page`.

The packaged sample, and a made scene of so many Gaussians; each in Debian's Chromium with software WebGL, and without
WebGL, where the server draws. Times are since the navigation began, in a new profile, of a server on the same machine;
what the browser computes it computes on the same CPUs. Lighthouse judges the list of scenes and the sample. Rows go to
benchmarks/results/page.json.
"""

from __future__ import annotations

import dataclasses
import os
import tempfile
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from benchmarks.page.lighthouse import audited
from benchmarks.page.measured_visit import Visited, opened, visit
from benchmarks.provenance import MADE_FAST_HERE, ROOT, begin, parser_of, write_results
from benchmarks.serve.api_process import Api
from benchmarks.serve.stored_scenes import add_scene, room, seen_around
from fastsplat.service.settings import Settings
from fastsplat.service.store.care.sample_scene import unpack_sample
from fastsplat.service.store.store import open_store
from fastsplat_client import Client
from fastsplat_contract.messages.scenes import SceneSummary


def main() -> None:
    """Visit every scene with and without WebGL, print the rows, write the file."""
    parser = parser_of(__doc__)
    parser.add_argument("--gaussians", type=int, default=1_000_000, help="of the made scene; 0: none")
    parser.add_argument("--seconds", type=float, default=10.0, help="how long to orbit")
    arguments = parser.parse_args()
    models = Path(os.environ.get("FASTSPLAT_MODELS", ROOT / ".models")).resolve()
    start = begin()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="fastsplat-page-") as folder:
        sample = Settings(data_dir=Path(folder) / "sample", models=models, auth="off")
        unpack_sample(sample.data_dir)
        rows += _rows("sample", sample, "banana", arguments.seconds)
        judged = _judged(sample)
        if arguments.gaussians:
            room_settings = Settings(data_dir=Path(folder) / "made", models=models, auth="off")
            store = open_store(room_settings.data_dir, room_settings.database_url)
            add_scene(store, seen_around(room(arguments.gaussians, models)))
            rows += _rows("made", room_settings, "teddy bear", arguments.seconds)
    write_results("page", start, arguments, MADE_FAST_HERE, {"rows": rows, "lighthouse": judged})


def _rows(name: str, settings: Settings, text: str, seconds: float) -> list[dict[str, Any]]:
    """A scene with and without WebGL."""
    rows = []
    with Api(settings, {}) as api, sync_playwright() as playwright:
        url = f"http://127.0.0.1:{api.http_port}"
        scene = _scene(url)
        for webgl in (True, False):
            with opened(playwright, webgl=webgl) as browser:
                visited = visit(browser, url, scene.id, text, seconds)
            row = {"scene": name, "gaussians": scene.gaussians, "webgl": webgl, **_rounded(visited)}
            print(row, flush=True)
            rows.append(row)
    return rows


def _judged(settings: Settings) -> dict[str, Any]:
    """What Lighthouse says of the list of scenes, and of a scene."""
    with Api(settings, {}) as api:
        url = f"http://127.0.0.1:{api.http_port}"
        return {"scenes": audited(f"{url}/"), "scene": audited(f"{url}/#/scenes/{_scene(url).id}")}


def _scene(url: str) -> SceneSummary:
    with Client(url) as client:
        return next(iter(client.scenes()))


def _rounded(visited: Visited) -> dict[str, Any]:
    values = dataclasses.asdict(visited)
    return {name: round(value, 3) if isinstance(value, float) else value for name, value in values.items()}


if __name__ == "__main__":
    main()
