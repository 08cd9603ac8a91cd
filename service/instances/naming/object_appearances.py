"""Appearance of objects in their photos, for recognition in other scenes of the project."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
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
class Sight:
    """An object in a view."""

    worth: float  # pixels, less if the picture's edge cuts it off
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
    owners = drawn_owners(objects, gaussians, views, _MAX_VIEWS, max_side, backend)
    best = best_sights(owners, [obj.id for obj in objects.table])
    features: dict[int, list[NDArray[np.float32]]] = {obj: [] for obj in best}
    embeddings: dict[int, list[NDArray[np.float32]]] = {obj: [] for obj in best}
    pictures: dict[int, bytes] = {}
    for number, seen in sights_by_view(best).items():
        image = load_image(views[number])
        masks = [_enlarged(sight.mask, image.shape[:2]) for _, sight in seen]
        if looks is not None:
            for (obj, _), embedding in zip(seen, looks.embed(image, masks), strict=True):
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
            obj = replace(obj, looks=Looks(looks.sha256, pooled_embedding(embeddings[obj.id]).tobytes()))
        return obj

    return replace(objects, table=tuple(map(described, objects.table)))


def drawn_owners(
    objects: Objects, gaussians: Gaussians, views: Sequence[View], most: int, max_side: int, backend: Backend
) -> Iterator[tuple[int, NDArray[np.uint16]]]:
    """Yields numbers of at most `most` views with the object of each pixel, uint16 [h, w], 0 for none."""
    device = device_of(backend)
    splats, blend = splats_of(gaussians, device=device), objects_blend(objects, gaussians.codes, device)
    for number in spread(len(views), most):
        camera = training_size(views[number].posed.camera, max_side)
        viewmat = torch.from_numpy(views[number].posed.camera_from_world().astype(np.float32)).to(device)
        drawn = blend.render(splats, viewmat, camera, alpha_min=_ALPHA_MIN, relevancy=None, backend=backend)
        yield number, drawn.classes.cpu().numpy().astype(np.uint16)


def best_sights(
    owners: Iterable[tuple[int, NDArray[np.integer]]], object_ids: Iterable[int]
) -> Mapping[int, Sequence[Sight]]:
    """Maps object ids to their best views, the best first.

    Args:
        owners: numbers of views, with the object id of each pixel [H, W], 0 for none.
    """
    sights: dict[int, list[Sight]] = {object_id: [] for object_id in object_ids}
    for number, owner in owners:
        areas = np.bincount(owner.ravel(), minlength=max(sights, default=0) + 1)
        edge = {*owner[0], *owner[-1], *owner[:, 0], *owner[:, -1]}
        for object_id, before in sights.items():
            if areas[object_id] >= _LEAST_SHARE * owner.size:
                worth = float(areas[object_id]) * (_CUT_OFF if object_id in edge else 1.0)
                found = [*before, Sight(worth, number, owner == object_id)]
                sights[object_id] = sorted(found, key=lambda sight: -sight.worth)[:_BEST]
    return {object_id: found for object_id, found in sights.items() if found}


def sights_by_view(sights: Mapping[int, Sequence[Sight]]) -> Mapping[int, Sequence[tuple[int, Sight]]]:
    """Object ids with their sights, by number of the view, ascending."""
    rows = [(sight.view, object_id, sight) for object_id, found in sights.items() for sight in found]
    numbers = sorted({view for view, *_ in rows})
    return {number: [(object_id, sight) for view, object_id, sight in rows if view == number] for number in numbers}


def pooled_embedding(embeddings: Sequence[NDArray[np.float32]]) -> NDArray[np.float16]:
    """Mean of an object's embeddings [E] over its views, float16 [E] of unit length."""
    mean = np.mean(embeddings, axis=0)
    return np.asarray(mean / np.linalg.norm(mean), np.float16)


def _enlarged(mask: NDArray[np.bool_], size: tuple[int, ...]) -> NDArray[np.bool_]:
    return cv2.resize(mask.astype(np.uint8), (size[1], size[0]), interpolation=cv2.INTER_NEAREST) > 0
