"""Label supervision of a training run."""

from __future__ import annotations

import torch

from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import LabelMode
from fastsplat.service.splatting.labels.semantics import class_weights, code_size, separated_codes
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import Frame


class LabelSupervision:
    """Supervises codes by label maps from the first step.

    Attributes:
        labels: N, 0 without label maps.
        class_codes: [N + 1, D], initial codes of the classes.
        exact: the label maps came with the capture, so they agree with each other.
        class_weights: [N + 1], pixel weights of the cross-entropy.
    """

    def __init__(self, labelling: Labelling, settings: TrainingSettings, device: torch.device) -> None:
        self.labels = len(labelling.dictionary) if labelling.label_maps else 0
        self.mode: LabelMode = "evidence" if settings.label_mode == "evidence" else "codes"
        size = code_size(self.labels, settings.code_size) if self.mode == "codes" else 0
        self.class_codes = separated_codes(self.labels + 1, size, settings.seed)
        self.exact = labelling.exact
        self.undetected_weight = 1.0 if labelling.exact else settings.undetected_weight
        self.class_weights = class_weights(self.labels + 1, self.undetected_weight).to(device)
        self._every = settings.semantic_every

    def applies(self, frame: Frame, iteration: int) -> bool:
        """Tests if the cross-entropy enters this step's loss."""
        trained = self.mode == "codes" and self.labels > 0 and frame.labels is not None
        return trained and iteration % self._every == 0
