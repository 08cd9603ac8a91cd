"""Rendering of a scene from a pose: colors, depth, label maps and masks."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.query.drawing.view_geometry import ViewGeometry, view_geometry
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import F32, Evidence, Objects, Parts, Scene
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.labels.blending import (
    EvidenceBlend,
    LabelBlend,
    ObjectBlend,
    label_blend,
    objects_blend,
)
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import LabelMap, Rendering
from fastsplat.service.splatting.raster.rendering import rasterize, sh_to_rgb
from fastsplat_contract.geometry.camera import PosedCamera

_SURE_PX = 64
"""Weight in pixels by which a Gaussian without a part belongs to none."""


@dataclass(frozen=True)
class Mask2D:
    """An answer's mask in one view."""

    mask: NDArray[np.bool_]  # bool [H, W], pixels whose most probable class is a relevant entry
    label_ids: NDArray[np.uint16]  # uint16 [H, W], each masked pixel's relevant entry; 0 elsewhere, or if it has none
    relevancy: NDArray[np.float32]  # float32 [H, W], 0..1: Σ_n p(n)·relevancy(n)
    rgb: NDArray[np.uint8]  # uint8 [H, W, 3], the rendered view


class Renderer:
    """Renderer that keeps a scene's activated Gaussians between views; thread-safe."""

    def __init__(self, scene: Scene, settings: QuerySettings) -> None:
        gaussians = scene.gaussians
        self._settings, self._codes = settings, gaussians.codes
        self._device = device_of(settings.backend)
        self._splats = splats_of(gaussians, device=self._device)
        self._means = self._splats.means
        self._sh = self._tensor(gaussians.sh)
        self._degree = gaussians.sh_degree
        self._classes = len(scene.dictionary) + 1
        self._labels = label_blend(scene, self._device)
        self._objects: LabelBlend | None = None
        self._parts: tuple[Parts, EvidenceBlend] | None = None

    def relabeled(self, scene: Scene) -> Renderer:
        """Returns a renderer of a scene with the same Gaussians and other labels."""
        renderer = copy.copy(self)
        renderer._classes = len(scene.dictionary) + 1
        renderer._labels = label_blend(scene, self._device, self._labels)
        renderer._objects = None
        return renderer

    def colors(self, posed: PosedCamera) -> NDArray[np.uint8]:
        """Renders colors on black, uint8 [H, W, 3]."""
        return _to_bytes(self._rasterize(posed, self._rgb(posed)).image)

    def depth(self, posed: PosedCamera) -> F32:
        """Renders Σ w·z / Σ w, float32 [H, W], scene units; 0 where alpha < `alpha_min`."""
        rendering = self._rasterize(posed, self._means.new_zeros(len(self._means), 1))
        covered = rendering.alpha >= max(self._settings.alpha_min, 1e-6)
        expected = torch.where(covered, rendering.depth / rendering.alpha.clamp_min(1e-6), 0.0)
        return _to_floats(expected)

    def geometry(self, posed: PosedCamera) -> ViewGeometry:
        """Renders depth, its spread, normals, confidence and colors of the surface."""
        splats = replace(self._splats, features=self._rgb(posed))
        return view_geometry(splats, posed, alpha_min=self._settings.alpha_min, backend=self._settings.backend)

    def label_map(self, posed: PosedCamera) -> NDArray[np.uint16]:
        """Renders the most probable class, uint16 [H, W]; 0: undetected or alpha < `alpha_min`."""
        return self._drawn_ids(self._labels, posed)

    def id_map(self, posed: PosedCamera, objects: Objects | Parts) -> NDArray[np.uint16]:
        """Renders the most probable object or part, uint16 [H, W]; 0: none or alpha < `alpha_min`.

        `objects` must be the same at every call, as they are cached."""
        if isinstance(objects, Parts):
            if self._parts is None or self._parts[0].membership is not objects.membership:
                classes = max(part.id for part in objects.table) + 1
                self._parts = objects, EvidenceBlend(_with_rest(objects.membership), classes, self._device)
            return self._drawn_ids(self._parts[1], posed)
        if isinstance(self._labels, ObjectBlend):
            return self._drawn_ids(self._labels.objects, posed)
        if self._objects is None:  # of labels: they are kept nowhere else
            self._objects = objects_blend(objects, self._codes, self._device)
        return self._drawn_ids(self._objects, posed)

    def _drawn_ids(self, blend: LabelBlend, posed: PosedCamera) -> NDArray[np.uint16]:
        drawn = self._label(blend, posed, self._means.new_zeros(len(self._means), 0), None)
        return np.asarray(drawn.classes.cpu().numpy(), dtype=np.uint16)

    def mask(self, posed: PosedCamera, relevant: tuple[int, ...], relevancy: F32) -> Mask2D:
        """Renders the mask of the classes `relevant` and the relevancy Σ_n p(n)·relevancy(n)·alpha.

        `relevancy` is float32 [N + 1], by class; class 0 (undetected) should be 0."""
        labels = self._label(self._labels, posed, self._rgb(posed), relevancy)
        assert labels.relevancy is not None
        classes = labels.classes.cpu().numpy()
        is_relevant = np.zeros(self._classes, dtype=np.bool_)
        is_relevant[list(relevant)] = True
        mask = is_relevant[classes] & (labels.alpha.cpu().numpy() >= self._settings.alpha_min)
        return Mask2D(
            mask=mask,
            label_ids=np.asarray(classes * mask, dtype=np.uint16),
            relevancy=_to_floats(labels.relevancy.clamp(0.0, 1.0)),
            rgb=_to_bytes(labels.image),
        )

    def _label(self, blend: LabelBlend, posed: PosedCamera, features: Tensor, relevancy: F32 | None) -> LabelMap:
        splats = replace(self._splats, features=features)
        with torch.no_grad():
            return blend.render(
                splats,
                self._viewmat(posed),
                posed.camera,
                alpha_min=self._settings.alpha_min,
                relevancy=relevancy,
                backend=self._settings.backend,
            )

    def _rasterize(self, posed: PosedCamera, features: Tensor) -> Rendering:
        splats = replace(self._splats, features=features)
        with torch.no_grad():
            return rasterize(splats, self._viewmat(posed), posed.camera, backend=self._settings.backend)

    def _viewmat(self, posed: PosedCamera) -> Tensor:
        return torch.tensor(posed.camera_from_world(), dtype=self._means.dtype, device=self._device)

    def _rgb(self, posed: PosedCamera) -> Tensor:
        position = torch.tensor(posed.world_from_camera[:3, 3], dtype=self._means.dtype, device=self._device)
        with torch.no_grad():
            return sh_to_rgb(self._means, self._sh, position, self._degree, backend=self._settings.backend)

    def _tensor(self, array: F32) -> Tensor:
        return torch.tensor(np.asarray(array), dtype=torch.float32, device=self._device)


def _with_rest(membership: Evidence) -> Evidence:
    """Assigns Gaussians without entries to class 0 (nothing)."""
    sizes = np.diff(membership.starts)
    rows, rest = np.repeat(np.arange(len(sizes)), sizes), np.flatnonzero(sizes == 0)
    return evidence_of(
        np.concatenate([rows, rest]),
        np.concatenate([membership.labels, np.zeros(len(rest), np.uint16)]),
        np.concatenate([membership.counts, np.full(len(rest), _SURE_PX * UNIT)]),
        len(sizes),
    )


def _to_bytes(image: Tensor) -> NDArray[np.uint8]:
    return np.asarray((image.clamp(0.0, 1.0) * 255.0).round().to(torch.uint8).cpu().numpy())


def _to_floats(image: Tensor) -> F32:
    return np.asarray(image.to(torch.float32).cpu().numpy())
