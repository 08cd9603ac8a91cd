"""Choices of the training room."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict


class TrainingSettings(BaseModel):
    """How long, how large and how fine a scene is trained."""

    model_config = ConfigDict(frozen=True)

    backend: Literal["cpu", "cuda", "reference"] = "cpu"
    seed: int = 0
