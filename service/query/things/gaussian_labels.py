"""The label of each Gaussian and its probability, whatever the scene's labels are made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.label_evidence import Posterior, posterior
from fastsplat.service.scene.types import F32, Evidence, Scene, SemanticHead, ThingSemantics, semantics_of

_CHUNK_LOGITS = 4 << 20


@dataclass(frozen=True)
class GaussianLabels:
    """Labels of G Gaussians.

    Attributes:
        classes: int32 [G], dictionary id of each Gaussian, 0 = undetected or never seen.
        confidence: float32 [G], 0..1, the probability of that class; 0 = never seen by a labelled view.
    """

    classes: NDArray[np.int32]
    confidence: F32


def label_gaussians(scene: Scene) -> GaussianLabels:
    """The most probable class of each Gaussian: by its code (softmax of W·code + b), by its evidence (Dirichlet
    posterior), or the name of its most probable thing, see `semantics_of`."""
    semantics = semantics_of(scene)
    if isinstance(semantics, ThingSemantics):
        return label_by_things(semantics, posterior(semantics.membership, len(semantics.label_ids)))
    if isinstance(semantics, Evidence):
        belief = posterior(semantics, len(scene.dictionary) + 1)
        return GaussianLabels(belief.classes, belief.confidence)
    return classify_codes(semantics.codes, semantics.head)


def label_by_things(semantics: ThingSemantics, belief: Posterior) -> GaussianLabels:
    """The name of the most probable thing of each Gaussian, of the posterior of its membership."""
    return GaussianLabels(semantics.label_ids[belief.classes], belief.confidence)


def classify_codes(codes: F32, head: SemanticHead) -> GaussianLabels:
    """The class with the largest softmax(W·code + b) of each code [G, D]; ties go to the lower id.

    With a single class (a scene without labels) nothing was learnt by the codes, and the confidence is 0. Works through
    bounded pieces: a million Gaussians and a thousand labels need 16 MiB beside the result.
    """
    classes = np.zeros(len(codes), dtype=np.int32)
    confidence = np.zeros(len(codes), dtype=np.float32)
    class_count = len(head.bias)
    if class_count == 1:
        return GaussianLabels(classes, confidence)
    rows = max(1, _CHUNK_LOGITS // class_count)
    for start in range(0, len(codes), rows):
        piece = slice(start, start + rows)
        logits = codes[piece] @ head.weight.T
        logits += head.bias
        classes[piece] = logits.argmax(axis=1)
        logits -= logits.max(axis=1, keepdims=True)
        confidence[piece] = 1 / np.exp(logits, out=logits).sum(axis=1)
    return GaussianLabels(classes, confidence)
