"""Segmenters: boxes to masks."""

from __future__ import annotations

from pathlib import Path

from fastsplat.service.perception.models.model_files import encoder_and_decoder
from fastsplat.service.perception.models.model_manifest import find_model
from fastsplat.service.perception.segmenters.sam1 import Sam1
from fastsplat.service.perception.segmenters.sam2 import Sam2
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.types import Segmenter


def open_segmenter(settings: PerceptionSettings, models: Path) -> Segmenter:
    """The segmenter that `settings.segmenter` names.

    Raises:
        ModelUnavailableError: unknown name, missing or damaged file, broken contract.
    """
    name = settings.segmenter
    adapter, inside = find_model(name, "segmenter")
    encoder, decoder = encoder_and_decoder(models / inside, name=name)
    kind = Sam1 if adapter == "sam1" else Sam2
    return kind(encoder, decoder, name=name, threads=settings.threads)
