"""Which label each Gaussian has and how sure that is, whatever the scene keeps its labels in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.labels import codes_field
from fastsplat.service.scene.evidence import posterior
from fastsplat.service.scene.types import F32, Scene


@dataclass(frozen=True)
class LabelField:
    """Labels of G Gaussians.

    Attributes:
        classes: int32 [G], dictionary id of each Gaussian, 0 = undetected or never seen.
        confidence: float32 [G], 0..1, the probability of that class; 0 = never seen by a labelled view.
    """

    classes: NDArray[np.int32]
    confidence: F32


def label_field(scene: Scene) -> LabelField:
    """The scene's labels: by its codes (softmax of W·code + b) or by its evidence (Dirichlet posterior), as
    `scene.label_mode` says."""
    evidence = scene.answering_evidence
    if evidence is None:
        return LabelField(*codes_field(scene.gaussians.codes, scene.head))
    found = posterior(evidence, len(scene.dictionary) + 1)
    return LabelField(found.classes, found.confidence)
