"""Label and probability of each Gaussian, for all kinds of semantics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.scene import F32, Evidence, ObjectSemantics, Scene
from fastsplat.service.scene.objects.label_evidence import Posterior, posterior
from fastsplat.service.scene.objects.object_codes import classes_of_codes


@dataclass(frozen=True)
class GaussianLabels:
    """Labels of G Gaussians."""

    classes: NDArray[np.int32]  # int32 [G], dictionary id of each Gaussian, 0 = undetected or never seen
    confidence: F32  # float32 [G], 0..1, the probability of that class; 0 = never seen by a labelled view


def label_gaussians(scene: Scene) -> GaussianLabels:
    """Labels Gaussians by codes (softmax of W·code + b), evidence (Dirichlet posterior) or objects."""
    semantics = scene.semantics()
    if isinstance(semantics, ObjectSemantics):
        return label_by_objects(semantics, posterior(semantics.objects.membership, len(semantics.label_ids)))
    if isinstance(semantics, Evidence):
        belief = posterior(semantics, len(scene.dictionary) + 1)
        return GaussianLabels(belief.classes, belief.confidence)
    return GaussianLabels(*classes_of_codes(semantics.codes, semantics.head))


def label_by_objects(semantics: ObjectSemantics, belief: Posterior) -> GaussianLabels:
    """Labels each Gaussian with the name of its most probable object."""
    return GaussianLabels(semantics.label_ids[belief.classes], belief.confidence)
