"""Appearance of objects in their photos, for recognition in other scenes of the project."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.capture.build import load_image
from fastsplat.service.capture.captures import View
from fastsplat.service.perception.appearance import AppearanceEncoder, descriptor_of, small_picture
from fastsplat.service.perception.image_text import ClipImageText
from fastsplat.service.perception.label_maps.capture_detection import spread
from fastsplat.service.scene.artefact.scene import Gaussians, Looks, Object, Objects
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.labels.blending import objects_blend
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.training_views import training_size

_MAX_VIEWS = 16
_BEST = 5  # number of views that describe an object; 1, 3 and 5 were measured
_LEAST_SHARE = 0.0015  # least share of a view's pixels that an object must cover
_CUT_OFF = 0.4  # factor for the area of an object that reaches the picture's edge
_ALPHA_MIN = 0.5


@dataclass(frozen=True)
class _Sight:
    """An object in a view."""

    worth: float
    view: int
    mask: NDArray[np.bool_] = field(repr=False)


@torch.no_grad()
def with_appearances(
    objects: Objects,
    gaussians: Gaussians,
    views: Sequence[View],
    encoder: AppearanceEncoder | None,
    max_side: int,
    *,
    looks: ClipImageText | None = None,
    backend: Backend = "cpu",
) -> Objects:
    """Adds descriptor, small picture and looks to objects, from their largest views.

    Args:
        views: of the capture; at most 16 are used, spread evenly.
        encoder: computes features; None: no descriptors and pictures.
        max_side: pixels of the rendered image's longer side.
        looks: computes embeddings; None: no looks.
    """
    best = _best_sights(objects, gaussians, views, max_side, backend)
    features: dict[int, list[NDArray[np.float32]]] = {obj: [] for obj in best}
    embeddings: dict[int, list[NDArray[np.float32]]] = {obj: [] for obj in best}
    pictures: dict[int, bytes] = {}
    for number in sorted({sight.view for sights in best.values() for sight in sights}):
        image = load_image(views[number])
        seen = [(obj, sight) for obj, sights in best.items() for sight in sights if sight.view == number]
        masks = [_enlarged(sight.mask, image.shape[:2]) for _, sight in seen]
        if looks is not None:
            for (obj, _), embedding in zip(seen, looks.embed_all(image, masks), strict=True):
                embeddings[obj].append(embedding)
        if encoder is not None:
            for (obj, sight), mask in zip(seen, masks, strict=True):
                features[obj].append(encoder.features(image, mask))
                if sight is best[obj][0]:
                    pictures[obj] = small_picture(image, mask)

    def described(obj: Object) -> Object:
        if features.get(obj.id):
            appearance = descriptor_of(features[obj.id]).tobytes()
            obj = replace(obj, appearance=appearance, picture=pictures[obj.id])
        if looks is not None and embeddings.get(obj.id):
            mean = np.mean(embeddings[obj.id], axis=0)
            embedding = (mean / np.linalg.norm(mean)).astype(np.float16).tobytes()
            obj = replace(obj, looks=Looks(looks.sha256, embedding))
        return obj

    return replace(objects, table=tuple(map(described, objects.table)))


def _best_sights(
    objects: Objects, gaussians: Gaussians, views: Sequence[View], max_side: int, backend: Backend
) -> Mapping[int, Sequence[_Sight]]:
    """Maps object ids to their best views, the best first."""
    device = device_of(backend)
    splats = splats_of(gaussians, device=device)
    classes = max((obj.id for obj in objects.table), default=0) + 1
    blend = objects_blend(objects, gaussians.codes, device)
    sights: dict[int, list[_Sight]] = {}
    for number in spread(len(views), _MAX_VIEWS):
        camera = training_size(views[number].posed.camera, max_side)
        viewmat = torch.from_numpy(views[number].posed.camera_from_world().astype(np.float32)).to(device)
        drawn = blend.render(splats, viewmat, camera, alpha_min=_ALPHA_MIN, relevancy=None, backend=backend)
        owner = drawn.classes.cpu().numpy()
        areas = np.bincount(owner.ravel(), minlength=classes)
        edge = {*owner[0], *owner[-1], *owner[:, 0], *owner[:, -1]}
        for obj in objects.table:
            if areas[obj.id] >= _LEAST_SHARE * owner.size:
                worth = float(areas[obj.id]) * (_CUT_OFF if obj.id in edge else 1.0)
                seen = [*sights.get(obj.id, ()), _Sight(worth, number, owner == obj.id)]
                sights[obj.id] = sorted(seen, key=lambda sight: -sight.worth)[:_BEST]
    return sights


def _enlarged(mask: NDArray[np.bool_], size: tuple[int, ...]) -> NDArray[np.bool_]:
    return cv2.resize(mask.astype(np.uint8), (size[1], size[0]), interpolation=cv2.INTER_NEAREST) > 0
