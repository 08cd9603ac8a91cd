"""What a ranking reads of a scene: its labels, and nothing that has a row for each Gaussian."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.scene.types import Scene


@dataclass(frozen=True)
class SceneLabels:
    """The labels of a scene.

    Attributes:
        dictionary: N names: the scene's labels, then what is merely suggested, see `ThingNames`.
        embeddings: float32 [M, E], M ≤ N, unit length, of the scene's labels; a copy, so that no file of the scene
            stays mapped.
        text_encoder, templates: what made them: name and digest of the encoder, and the sentences.
    """

    dictionary: Dictionary
    embeddings: NDArray[np.float32]
    text_encoder: tuple[str, str]
    templates: tuple[str, ...]


def labels_of(scene: Scene, dictionary: Dictionary) -> SceneLabels:
    """The labels of a scene, with further names behind them."""
    return SceneLabels(dictionary, np.array(scene.label_embeddings), scene.text_encoder, scene.label_templates)
