"""Turns uploads into captures: photos, videos, COLMAP models and transforms.json in; undistorted posed views out.

The names below load what they need (image codecs, COLMAP) only when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fastsplat.service.capture.build import build_capture, load_image
    from fastsplat.service.capture.capture_files import load_capture, load_content
    from fastsplat.service.capture.upload_validation import validate_upload

__all__ = ["build_capture", "load_capture", "load_content", "load_image", "validate_upload"]

_MODULES = {
    "build_capture": "build",
    "load_capture": "capture_files",
    "load_content": "capture_files",
    "load_image": "build",
    "validate_upload": "upload_validation",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
