"""Opening of segmenters by their names in the settings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fastsplat.service.perception.models.model_files import batch_decoder, encoder_and_decoder
from fastsplat.service.perception.models.model_manifest import Adapter, find_model, select_adapter
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Segmenter
from fastsplat.service.perception.segmenters.sam1 import Sam1
from fastsplat.service.perception.segmenters.sam2 import Sam2


def open_segmenter(settings: PerceptionSettings, models: Path) -> Segmenter:
    """Opens the segmenter of `settings.segmenter`; raises `ModelUnavailableError` if that fails."""
    name = settings.segmenter
    adapter, inside = find_model(name, "segmenter")
    encoder, decoder = encoder_and_decoder(models / inside, name=name)
    segmenter = select_adapter(SEGMENTERS, adapter, name, "segmenter")
    if segmenter is Sam1:
        return Sam1(
            encoder, decoder, name=name, threads=settings.threads, batch=batch_decoder(models / inside, name=name)
        )
    return segmenter(encoder, decoder, name=name, threads=settings.threads)


SEGMENTERS: Mapping[Adapter, type[Sam1] | type[Sam2]] = {"sam1": Sam1, "sam2": Sam2}
"""Segmenters by the manifest's adapter."""
