"""Opening of lexicons by the name that a setting gives."""

from __future__ import annotations

from pathlib import Path

from fastsplat.service.perception.lexicon.wordnet import Lexicon
from fastsplat.service.perception.models.model_manifest import find_model


def open_lexicon(name: str, models: Path) -> Lexicon:
    """The lexicon that a setting names ("wordnet", or "wordnet:folder").

    Args:
        name: an entry of the manifest, or "wordnet:my_folder".

    Raises:
        ModelUnavailableError: unknown name, missing or damaged file.
    """
    _, inside = find_model(name, "lexicon")
    return Lexicon(models / inside, name=name)


def find_lexicon(name: str, models: Path) -> Lexicon | None:
    """The lexicon that a setting names; None where it names none, or one that was never fetched.

    Raises:
        ModelUnavailableError: unknown name, or a folder with a missing or damaged file.
    """
    if not name:
        return None
    _, inside = find_model(name, "lexicon")
    return open_lexicon(name, models) if (models / inside).is_dir() else None
