"""What a job and a scene can be."""

from __future__ import annotations

from typing import Literal

OperationState = Literal["QUEUED", "RUNNING", "SUCCEEDED", "FAILED", "CANCELLED"]
SceneState = Literal["TRAINING", "READY", "FAILED"]
