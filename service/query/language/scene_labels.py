"""What a ranking reads of a scene: its labels, and nothing that has a row for each Gaussian."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.query.things.absence import searched_names
from fastsplat.service.scene.types import LabelMode, Scene


@dataclass(frozen=True)
class SceneLabels:
    """The labels of a scene.

    Attributes:
        dictionary: N labels.
        embeddings: float32 [N, E], unit length; a copy, so that no file of the scene stays mapped.
        text_encoder, templates: what made them: name and digest of the encoder, and the sentences.
        mode: what the labels of Gaussians follow from, see `Scene`.
        searched: how many names were looked for; None if nobody noted it.
    """

    dictionary: Dictionary
    embeddings: NDArray[np.float32]
    text_encoder: tuple[str, str]
    templates: tuple[str, ...]
    mode: LabelMode
    searched: int | None


def labels_of(scene: Scene) -> SceneLabels:
    """The labels of a scene."""
    return SceneLabels(
        scene.dictionary,
        np.array(scene.label_embeddings),
        scene.text_encoder,
        scene.label_templates,
        scene.label_mode,
        searched_names(scene),
    )
