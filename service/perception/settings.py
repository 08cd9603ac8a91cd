"""Choices of the perception room."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class PerceptionSettings(BaseModel):
    """Which models look at the images, and how sure they must be."""

    model_config = ConfigDict(frozen=True)

    text_encoder: str = "minilm_l6_int8"
    """Name of a text encoder in the model manifest."""
