"""Opening of detectors by their names in the settings.

Functions raise `ModelUnavailableError` for an unknown name or adapter, a missing or damaged file, or a broken contract.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fastsplat.service.perception.detectors.grounding_dino import GroundingDino
from fastsplat.service.perception.detectors.owl import OwlV2, OwlViT
from fastsplat.service.perception.detectors.picodet import PicoDet
from fastsplat.service.perception.detectors.yolo_world import YoloWorld
from fastsplat.service.perception.models.model_files import only_network, only_table, tokenizer
from fastsplat.service.perception.models.model_manifest import Adapter, find_model, load_manifest, select_adapter
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import ClosedSetDetector, OpenSetDetector
from fastsplat.service.perception.text.text_encoders import LabelTable, open_text_encoder
from fastsplat_contract.errors import ModelUnavailableError


def open_closed_set_detector(settings: PerceptionSettings, models: Path) -> ClosedSetDetector:
    """Opens the detector of `settings.closed_set_detector`."""
    name = settings.closed_set_detector
    adapter, inside = find_model(name, "closed_set_detector")
    detector = select_adapter(CLOSED_SET_DETECTORS, adapter, name, "closed_set_detector")
    return detector(only_network(models / inside, name=name), name=name, threads=settings.threads)


def closed_set_labels(settings: PerceptionSettings) -> tuple[str, ...]:
    """Returns the classes of `settings.closed_set_detector` without opening it."""
    name = settings.closed_set_detector
    adapter, _ = find_model(name, "closed_set_detector")
    return tuple(select_adapter(CLOSED_SET_DETECTORS, adapter, name, "closed_set_detector").labels)


def open_open_set_detector(settings: PerceptionSettings, models: Path) -> OpenSetDetector:
    """Opens the detector of `settings.open_set_detector`, with its prompt encoder if it needs one."""
    check_open_set_detector(settings)
    name = settings.open_set_detector
    adapter, inside = find_model(name, "open_set_detector")
    detector = select_adapter(OPEN_SET_DETECTORS, adapter, name, "open_set_detector")
    network = only_network(models / inside, name=name)
    if issubclass(detector, YoloWorld):
        encoder = open_text_encoder(settings.prompt_encoder, models, threads=settings.threads)
        return detector(network, encoder, name=name, threads=settings.threads)
    return detector(network, tokenizer(models / inside, name=name), name=name, threads=settings.threads)


def of_open_set(settings: PerceptionSettings) -> PerceptionSettings:
    """The open-set detector's thresholds in the place of the closed-set detector's; its floor is two thirds."""
    threshold = settings.open_score_threshold
    if threshold is None:
        threshold = _USUAL_THRESHOLDS[find_model(settings.open_set_detector, "open_set_detector")[0]]
    return settings.model_copy(update={"score_threshold": threshold, "score_floor": threshold * 2 / 3})


def check_open_set_detector(settings: PerceptionSettings) -> None:
    """Checks, without opening it, that an open-set detector, with any text encoder, is configured."""
    if not settings.open_set_detector:
        known = ", ".join(entry.name for entry in load_manifest() if entry.role == "open_set_detector")
        raise ModelUnavailableError(
            "no open-set detector is configured, and a closed-set detector cannot look for words",
            field="perception.open_set_detector",
            hint=f"Set FASTSPLAT_PERCEPTION__OPEN_SET_DETECTOR to a model of the role open-set detector ({known}; "
            '"fastsplat models list" shows them, "fastsplat models pull NAME" fetches one), or to adapter:folder for '
            "your own, for the API and its workers.",
        )
    adapter, _ = find_model(settings.open_set_detector, "open_set_detector")
    if adapter == "yolo_world" and not settings.prompt_encoder:
        raise ModelUnavailableError(
            f"model {settings.open_set_detector} is prompted by embeddings, and no text encoder is set for it",
            field="perception.prompt_encoder",
            hint="Set the text encoder the detector was trained with, such as clip_vit_b32.",
        )


def check_texts_known(texts: Sequence[str], settings: PerceptionSettings, models: Path, *, field: str) -> None:
    """Raises `InvalidInputError`, for `field`, that names texts missing in a configured label table."""
    if table := _label_table(settings, models):
        table.check_known(texts, field)


def known_texts(texts: Sequence[str], settings: PerceptionSettings, models: Path) -> tuple[str, ...]:
    """Texts that the open-set detector can look for: all, unless a label table embeds them."""
    table = _label_table(settings, models)
    return tuple(text for text in texts if table is None or table.knows(text))


def _label_table(settings: PerceptionSettings, models: Path) -> LabelTable | None:
    name = settings.prompt_encoder
    if not settings.open_set_detector or not name:
        return None
    adapter, inside = find_model(name, "text_encoder")
    return LabelTable(only_table(models / inside, name=name), name=name) if adapter == "label_table" else None


CLOSED_SET_DETECTORS: Mapping[Adapter, type[PicoDet]] = {"picodet": PicoDet}
"""Closed-set detectors by the manifest's adapter."""

OPEN_SET_DETECTORS: Mapping[Adapter, type[GroundingDino] | type[OwlViT] | type[YoloWorld]] = {
    "grounding_dino": GroundingDino,
    "owlv2": OwlV2,
    "owlvit": OwlViT,
    "yolo_world": YoloWorld,
}
"""Open-set detectors by the manifest's adapter."""

_USUAL_THRESHOLDS: Mapping[Adapter, float] = {"grounding_dino": 0.3, "owlv2": 0.1, "owlvit": 0.1, "yolo_world": 0.15}
"""Scores from which detections count in public examples of open-set detectors, by adapter."""
