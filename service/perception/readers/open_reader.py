"""Opening of readers by their names in the settings."""

from __future__ import annotations

from pathlib import Path

from fastsplat.service.perception.models.model_files import checked_file
from fastsplat.service.perception.models.model_manifest import find_model
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.readers.ppocr import PpOcr


def open_reader(settings: PerceptionSettings, models: Path) -> PpOcr:
    """Opens the reader of `settings.reader`; raises `ModelUnavailableError` if that fails."""
    name = settings.reader
    _, inside = find_model(name, "reader")
    detector, recognizer = (checked_file(models / inside / file, name=name) for file in PpOcr.FILES)
    return PpOcr(detector, recognizer, name=name, threads=settings.threads)


def find_reader(settings: PerceptionSettings, models: Path) -> PpOcr | None:
    """Opens the reader of `settings.reader`; None if it is unset or was never fetched."""
    if not settings.reader:
        return None
    _, inside = find_model(settings.reader, "reader")
    return open_reader(settings, models) if (models / inside).is_dir() else None
