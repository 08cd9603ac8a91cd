"""Photos to names: a dictionary of what is in the capture and a label map per view."""

from __future__ import annotations

from service.perception.labelling import label_capture
from service.perception.storage import load_labelling, save_labelling

__all__ = ["label_capture", "load_labelling", "save_labelling"]
