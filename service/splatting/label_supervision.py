"""What a run learns labels from: which frames have a cross-entropy, what their pixels weigh, and when views agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.perception.types import Labelling
from fastsplat.service.scene.label_evidence import posterior
from fastsplat.service.scene.types import LabelMode
from fastsplat.service.splatting.gaussians import current_gaussians
from fastsplat.service.splatting.semantics import class_weights, code_size, separated_codes
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.state import SplatState
from fastsplat.service.splatting.torch_runtime import release_free_memory
from fastsplat.service.splatting.training_views import Frame, TrainingView, drop_empty_label_maps, with_labels

_CONSENSUS_AT = 0.5
"""Progress at which detected label maps of single views are replaced by those that all views agree on
(`service.splatting.label_consensus`). Before it color and geometry are trained alone, after it codes as well. Label
maps that came with the capture need no consensus."""
CONSENSUS_UNDETECTED_WEIGHT = 0.3
"""`undetected_weight` after the consensus: what all views missed is then likelier to be nothing."""

_PREFIX = "consensus."


class LabelSupervision:
    """The labels of a run.

    Exact label maps supervise the codes from the first step. Detected ones contradict each other from view to view, and
    only geometry can tell which regions show the same thing; so codes wait until, at `_CONSENSUS_AT`, the
    views' maps are replaced by those that all agree on, and start from what these say of each Gaussian.

    Args:
        labelling: of all views of the capture.
        training: indices of the training views.
        settings: the run's.
        device: where the frames are.

    Attributes:
        labels: N of the dictionary, 0 without label maps.
        mode: where the scene will keep its labels.
        class_codes: [N + 1, D], the codes that the classes start from.
        exact: whether the label maps came with the capture, so that they agree with each other.
        undetected_weight: what an undetected pixel weighs at present.
        class_weights: [N + 1], what pixels weigh in the cross-entropy at present.
    """

    def __init__(
        self, labelling: Labelling, training: Sequence[int], settings: TrainingSettings, device: torch.device
    ) -> None:
        self.labels = len(labelling.dictionary) if labelling.label_maps else 0
        self.mode: LabelMode = "evidence" if settings.label_mode == "evidence" else "codes"
        size = code_size(self.labels, settings.code_size) if self.mode == "codes" else 0
        self.class_codes = separated_codes(self.labels + 1, size, settings.seed)
        self._settings, self._device, self._expected = settings, device, labelling.expected
        detected = bool(labelling.regions) and self.labels > 0
        self._regions = tuple(labelling.regions[index] for index in training) if detected else ()
        self._fused, self.exact = False, labelling.exact
        self._weigh_undetected(1.0 if labelling.exact else settings.undetected_weight)

    def applies(self, frame: Frame, iteration: int) -> bool:
        """Whether the cross-entropy enters the loss of this step."""
        ready = self._fused or not self._regions
        trained = self.mode == "codes" and self.labels > 0 and frame.labels is not None
        return trained and ready and iteration % self._settings.semantic_every == 0

    def fuse_if_due(
        self, progress: float, state: SplatState, views: tuple[TrainingView, ...]
    ) -> tuple[TrainingView, ...]:
        """The views with the label maps that all agree on, once, when it is time; in evidence mode as late as possible.
        Codes of `state` then start from the evidence of these maps."""
        due = 1.0 if self.mode == "evidence" else _CONSENSUS_AT
        if self._fused or not self._regions or progress < due:
            return views
        # Loaded with the first detected capture: scipy takes 13 MB, which other runs do not need.
        from fastsplat.service.splatting.label_consensus import fuse_label_maps

        maps, evidence = fuse_label_maps(
            current_gaussians(state.parameters),
            views,
            self._regions,
            self.labels + 1,
            expected=self._expected,
            undetected_weight=CONSENSUS_UNDETECTED_WEIGHT,
            backend=self._settings.backend,
        )
        views = self._with_maps(views, maps)
        if self.mode == "codes":
            classes = torch.from_numpy(posterior(evidence, self.labels + 1).classes.astype(np.int64))
            state.parameters["codes"].data.copy_(self.class_codes[classes])
        release_free_memory()
        return views

    def tensors(self, views: Sequence[TrainingView]) -> dict[str, Tensor]:
        """What a checkpoint must hold of the labels: the maps, if they are no longer the detected ones."""
        if not self._fused:
            return {}
        blank = torch.zeros(1, 1, dtype=torch.uint8)
        maps = [view.frames[-1].labels for view in views]
        return {f"{_PREFIX}{i}": blank if labels is None else labels.cpu() for i, labels in enumerate(maps)}

    def restore(
        self, tensors: Mapping[str, Tensor], views: tuple[TrainingView, ...]
    ) -> tuple[dict[str, Tensor], tuple[TrainingView, ...]]:
        """A checkpoint's other tensors, and the views with its maps if it has some."""
        others = {name: value for name, value in tensors.items() if not name.startswith(_PREFIX)}
        if len(others) == len(tensors):
            return others, views
        return others, self._with_maps(views, [tensors[f"{_PREFIX}{i}"].numpy() for i in range(len(views))])

    def _with_maps(
        self, views: tuple[TrainingView, ...], maps: Sequence[NDArray[np.integer]]
    ) -> tuple[TrainingView, ...]:
        self._fused = True
        self._weigh_undetected(CONSENSUS_UNDETECTED_WEIGHT)
        labeled = [with_labels(view, labels) for view, labels in zip(views, maps, strict=True)]
        return tuple(view.to(self._device) for view in drop_empty_label_maps(labeled))

    def _weigh_undetected(self, weight: float) -> None:
        self.undetected_weight = weight
        self.class_weights = class_weights(self.labels + 1, weight).to(self._device)
