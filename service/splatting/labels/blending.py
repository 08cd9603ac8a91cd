"""Renders label and object maps from blended codes or posteriors."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.scene.artefact.scene import F32, Evidence, Objects, ObjectSemantics, Scene, SemanticHead
from fastsplat.service.scene.objects.label_evidence import posterior
from fastsplat.service.scene.objects.object_codes import codes_of_objects
from fastsplat.service.scene.objects.objects import object_rows
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend, LabelMap, Splats
from fastsplat.service.splatting.raster.rendering import label_map, rasterize
from fastsplat.service.splatting.raster.share_maps import ShareMaps
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera, PosedCamera


class LabelBlend(Protocol):
    """Renders label maps of a scene."""

    def render(
        self, splats: Splats, viewmat: Tensor, camera: Camera, alpha_min: float, relevancy: F32 | None, backend: Backend
    ) -> LabelMap:
        """Renders labels, and with [N + 1] `relevancy` its expectation times alpha.

        `splats.features` are returned as `image`.
        """


def label_blend(scene: Scene, device: torch.device, before: LabelBlend | None = None) -> LabelBlend:
    """Selects the blend by `Scene.semantics`; `before` is an earlier one of the same Gaussians."""
    semantics = scene.semantics()
    if isinstance(semantics, ObjectSemantics):
        return ObjectBlend(semantics, device, before if isinstance(before, ObjectBlend) else None)
    if isinstance(semantics, Evidence):
        return EvidenceBlend(semantics, len(scene.dictionary) + 1, device)
    return CodeBlend(semantics.codes, semantics.head, device)


@torch.no_grad()
def object_map(scene: Scene, posed: PosedCamera, *, backend: Backend = "cpu") -> NDArray[np.int32]:
    """Renders the most probable object id of each pixel, int32 [H, W], by `objects_blend`.

    0 means no object, or alpha below 0.5.

    Raises:
        InvalidInputError: a scene without objects.
    """
    if scene.objects is None:
        raise InvalidInputError("this scene has no objects", field="objects", hint="Discover them first.")
    device = device_of(backend)
    blend = objects_blend(scene.objects, scene.gaussians.codes, device)
    viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32)).to(device)
    splats = splats_of(scene.gaussians, device=device)
    drawn = blend.render(splats, viewmat, posed.camera, alpha_min=0.5, relevancy=None, backend=backend)
    return np.asarray(drawn.classes.cpu().numpy(), np.int32)


class CodeBlend:
    """Classifies composited codes, not divided by alpha, as the training loss does."""

    def __init__(self, codes: F32, head: SemanticHead, device: torch.device) -> None:
        self._codes = torch.tensor(np.asarray(codes), device=device)
        self._weight = torch.tensor(np.asarray(head.weight), device=device)
        self._bias = torch.tensor(np.asarray(head.bias), device=device)

    def render(
        self, splats: Splats, viewmat: Tensor, camera: Camera, alpha_min: float, relevancy: F32 | None, backend: Backend
    ) -> LabelMap:
        coded = replace(splats, features=torch.cat([splats.features, self._codes], dim=1))
        sought = None if relevancy is None else torch.tensor(relevancy, device=self._weight.device)
        head = self._weight, self._bias
        labels = label_map(coded, viewmat, camera, *head, alpha_min=alpha_min, relevancy=sought, backend=backend)
        if labels.relevancy is None:
            return labels
        return replace(labels, relevancy=labels.relevancy * labels.alpha)


class EvidenceBlend:
    """Classifies by argmax_n Σ_g w_g A[g, n] / (Σ A[g] + α0).

    The blended posterior without its uniform part, so Gaussians without evidence do not count; ties go to the lower id.
    """

    def __init__(self, evidence: Evidence, classes: int, device: torch.device) -> None:
        self.evidence = evidence
        mean = posterior(evidence, classes)
        self._rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
        self._shares = mean.probability - mean.rest[self._rows]
        self._maps = ShareMaps(evidence.starts, evidence.labels, self._shares)
        self._device = device

    def render(
        self, splats: Splats, viewmat: Tensor, camera: Camera, alpha_min: float, relevancy: F32 | None, backend: Backend
    ) -> LabelMap:
        labels = self._maps.draw(splats, viewmat, camera, alpha_min=alpha_min, backend=backend)
        leading = splats.features
        if relevancy is not None:
            sums = np.bincount(self._rows, self._shares * relevancy[self.evidence.labels], len(self.evidence))
            expected = torch.tensor(sums, dtype=splats.means.dtype, device=self._device)[:, None]
            leading = torch.cat([leading, expected], dim=1)
        if not leading.shape[1]:
            return labels
        channels = splats.features.shape[1]
        image = rasterize(replace(splats, features=leading), viewmat, camera, backend=backend).image
        return replace(
            labels, image=image[..., :channels], relevancy=None if relevancy is None else image[..., channels]
        )


def objects_blend(objects: Objects, codes: F32, device: torch.device) -> LabelBlend:
    """Selects the blend for object ids: composited codes if trained, else membership."""
    if objects.head is None:
        return EvidenceBlend(objects.membership, max((obj.id for obj in objects.table), default=0) + 1, device)
    coded = codes_of_objects(codes, objects.head, object_rows(objects))
    return _Renamed(CodeBlend(coded.codes, coded.head, device), coded.ids)


class _Renamed:
    """Maps the classes of another blend to `ids`, which also index relevancy."""

    def __init__(self, blend: LabelBlend, ids: NDArray[np.integer]) -> None:
        self._blend, self._ids = blend, ids

    def render(
        self, splats: Splats, viewmat: Tensor, camera: Camera, alpha_min: float, relevancy: F32 | None, backend: Backend
    ) -> LabelMap:
        by_class = None if relevancy is None else relevancy[self._ids]
        drawn = self._blend.render(splats, viewmat, camera, alpha_min=alpha_min, relevancy=by_class, backend=backend)
        return replace(drawn, classes=torch.tensor(self._ids, device=drawn.classes.device)[drawn.classes.long()])


class ObjectBlend(_Renamed):
    """Labels pixels by the name of their object.

    A label's mask is the union of its objects' masks. Reuses the blend of `before` if the membership is the same
    object.
    """

    def __init__(self, semantics: ObjectSemantics, device: torch.device, before: ObjectBlend | None = None) -> None:
        self.members = semantics.objects.membership
        same = before is not None and before.members is self.members
        self.objects: LabelBlend = (
            before.objects if same and before else objects_blend(semantics.objects, semantics.codes, device)
        )
        super().__init__(self.objects, semantics.label_ids)
