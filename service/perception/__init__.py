"""Photos to a dictionary of what is in the capture, and a label map per view.

The names below load what they need (onnxruntime, tokenizers) only when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fastsplat.service.perception.labelling import label_capture
    from fastsplat.service.perception.labelling_files import load_labelling, save_labelling

__all__ = ["label_capture", "load_labelling", "save_labelling"]

_HOMES = {"label_capture": "labelling", "load_labelling": "labelling_files", "save_labelling": "labelling_files"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
