"""What Google's Lighthouse says of a page."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from typing import Any

_VERSION = "12.8.2"
_CATEGORIES = ("performance", "accessibility")
_MOMENTS = ("first-contentful-paint", "largest-contentful-paint", "total-blocking-time", "speed-index")
_CHROMIUM = "--headless=new --no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"


def audited(url: str) -> dict[str, Any]:
    """A page's scores, 0..100, and when it was there, seconds; by Lighthouse's defaults, a phone of the middle class.

    Args:
        url: of the page, which asks for no key.

    Raises:
        SystemExit: there is no npx or no Chromium.
        CalledProcessError: Lighthouse has failed.
    """
    path = shutil.which("chromium")
    if path is None or shutil.which("npx") is None:
        raise SystemExit("chromium and npx are needed: apt-get install chromium npm")
    command = ["npx", "--yes", f"lighthouse@{_VERSION}", url, "--quiet", "--output=json", "--output-path=stdout"]
    options = [f"--only-categories={','.join(_CATEGORIES)}", f"--chrome-flags={_CHROMIUM}"]
    environment = {**os.environ, "CHROME_PATH": path}
    said = subprocess.run([*command, *options], env=environment, stdout=subprocess.PIPE, check=True)
    report = json.loads(said.stdout)
    return {
        **{name: round(100 * report["categories"][name]["score"]) for name in _CATEGORIES},
        **{f"{name}_s": round(report["audits"][name]["numericValue"] / 1000, 3) for name in _MOMENTS},
    }
