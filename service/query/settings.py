"""Choices of the query room."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class QuerySettings(BaseModel):
    """How a text is compared with the dictionary."""

    model_config = ConfigDict(frozen=True)

    negatives: tuple[str, ...] = ("object", "things", "stuff", "texture")
    """Canonical negatives (LERF)."""
    temperature: float = 10.0
    """t of the pairwise softmax (LERF)."""
    max_text_chars: int = 1_000
    max_texts: int = 64
    max_poses: int = 64
