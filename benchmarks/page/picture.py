"""The README's picture of the page: `python -m benchmarks.page.picture` (or `make page-picture`).

The trained sample of `make demo`, asked for an object, as the page shows it: docs/page.jpg.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import ViewportSize, sync_playwright

from benchmarks.page.measured_visit import opened
from benchmarks.provenance import ROOT, parser_of
from benchmarks.serve.api_process import Api
from fastsplat.service.settings import Settings
from fastsplat_client import Client

_OUT = ROOT / "docs" / "page.jpg"
_SAMPLE = ROOT / "demo-output" / "service"
_WINDOW: ViewportSize = {"width": 1280, "height": 800}
_MOST_BYTES = 300_000
_QUALITIES = (90, 85, 80, 75, 70, 60)


def main() -> None:
    """Take the picture, and write it with the best quality that fits."""
    parser = parser_of(__doc__)
    parser.add_argument("--sample", type=Path, default=_SAMPLE, help="data folder with the trained sample")
    parser.add_argument("--text", default="banana", help="what is asked")
    parser.add_argument("--out", type=Path, default=_OUT)
    arguments = parser.parse_args()
    if not (arguments.sample / "fastsplat.sqlite").is_file():
        parser.error(f"{arguments.sample} has no trained sample: run make demo first, or name a folder by --sample")
    models = Path(os.environ.get("FASTSPLAT_MODELS", ROOT / ".models")).resolve()
    with tempfile.TemporaryDirectory(prefix="fastsplat-page-") as folder:
        settings = Settings(data_dir=Path(folder) / "sample", models=models)
        shutil.copytree(arguments.sample, settings.data_dir)
        with Api(settings, {}) as api:
            screen = _screen(f"http://127.0.0.1:{api.http_port}", api.key, arguments.text)
    picture = Image.open(io.BytesIO(screen)).convert("RGB")
    for quality in _QUALITIES:
        file = io.BytesIO()
        picture.save(file, "JPEG", quality=quality, optimize=True)
        if len(file.getvalue()) <= _MOST_BYTES:
            break
    arguments.out.write_bytes(file.getvalue())
    print(f"{arguments.out}: {len(file.getvalue())} bytes")


def _screen(url: str, key: str, text: str) -> bytes:
    """A PNG of the page with the answer."""
    with Client(url, key=key) as client:
        scene = next(iter(client.scenes()))
    with sync_playwright() as playwright, opened(playwright, webgl=True) as browser:
        page = browser.new_page(viewport=_WINDOW, reduced_motion="reduce")
        page.add_init_script(f"localStorage.setItem('fastsplat-key', {json.dumps(key)})")
        # From the scene's first camera: with the question in the address, nothing flies.
        page.goto(f"{url}/#/scenes/{scene.id}?q={text}")
        page.locator("canvas[data-shown$=answer]").wait_for(timeout=120_000)
        page.wait_for_timeout(5_000)  # software WebGL draws late
        return page.screenshot()


if __name__ == "__main__":
    main()
