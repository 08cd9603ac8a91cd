"""Shows the page of a data folder in a desktop's browser, without keys."""

from __future__ import annotations

import os
import sys
import threading
import time
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import typer

from fastsplat.cli.lazy_settings import load_settings
from fastsplat.cli.operating.serve_command import serve

if TYPE_CHECKING:
    from fastsplat.service.settings import Settings

_START_SECONDS = 60


def serve_in_browser(folder: Path) -> NoReturn:
    """Serves a data folder without keys until SIGTERM or SIGINT, and opens a desktop's browser."""
    os.environ["FASTSPLAT_DATA_DIR"] = str(folder.resolve())
    if has_desktop():
        threading.Thread(target=_open_browser, args=(load_settings(),), daemon=True).start()
    serve(no_auth=True)
    raise typer.Exit


def has_desktop() -> bool:
    """True if a browser has a screen; one in a terminal would take it over."""
    return sys.platform in ("darwin", "win32") or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def is_ready(url: str) -> bool:
    """True if the service at this address answers within two seconds that it is ready."""
    import httpx  # what a mere `--help` does without

    try:
        return httpx.get(f"{url}/readyz", timeout=2).is_success
    except httpx.TransportError:
        return False


def _open_browser(settings: Settings) -> None:
    url = f"{'https' if settings.tls_cert else 'http'}://localhost:{settings.http_port}"
    for _ in range(_START_SECONDS):
        if is_ready(url):
            webbrowser.open(url)
            return
        time.sleep(1.0)
