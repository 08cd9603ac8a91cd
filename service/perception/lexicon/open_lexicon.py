"""Opening of lexicons by their names in the settings."""

from __future__ import annotations

from pathlib import Path

from fastsplat.service.perception.lexicon.wordnet import Lexicon
from fastsplat.service.perception.models.model_manifest import find_model


def open_lexicon(name: str, models: Path) -> Lexicon:
    """Opens a lexicon by manifest entry or "wordnet:my_folder"; may raise `ModelUnavailableError`."""
    _, inside = find_model(name, "lexicon")
    return Lexicon(models / inside, name=name)


def find_lexicon(name: str, models: Path) -> Lexicon | None:
    """Opens a lexicon as `open_lexicon`; None if unnamed or never fetched."""
    if not name:
        return None
    _, inside = find_model(name, "lexicon")
    return open_lexicon(name, models) if (models / inside).is_dir() else None
