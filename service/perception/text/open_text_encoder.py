"""Opening of text encoders by their names in the settings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fastsplat.service.perception.models.model_files import only_network, only_table, tokenizer
from fastsplat.service.perception.models.model_manifest import Adapter, find_model, select_adapter
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.perception.text.label_table import LabelTable
from fastsplat.service.perception.text.text_tower import ClipTextEncoder, SentenceEncoder


def open_text_encoder(name: str, models: Path, *, threads: int = 0) -> TextEncoder:
    """Opens a text encoder by manifest entry or "adapter:folder"; may raise `ModelUnavailableError`.

    `threads` texts are embedded at a time; 0: as many as cores.
    """
    adapter, inside = find_model(name, "text_encoder")
    folder = models / inside
    if adapter == "label_table":
        return LabelTable(only_table(folder, name=name), name=name)
    encoder = select_adapter(TEXT_TOWERS, adapter, name, "text_encoder")
    return encoder(only_network(folder, name=name), tokenizer(folder, name=name), name=name, threads=threads)


TEXT_TOWERS: Mapping[Adapter, type[SentenceEncoder] | type[ClipTextEncoder]] = {
    "sentence": SentenceEncoder,
    "clip": ClipTextEncoder,
}
"""Text encoders that are networks, by the manifest's adapter."""
