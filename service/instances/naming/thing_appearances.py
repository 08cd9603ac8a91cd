"""Appearance of things in their photos, for recognition in other scenes of the project."""

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
from fastsplat.service.scene.artefact.scene import Gaussians, Looks, Thing, Things
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.labels.blending import things_blend
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.training_views import training_size

_MAX_VIEWS = 16
_BEST = 5  # number of views that describe a thing; 1, 3 and 5 were measured
_LEAST_SHARE = 0.0015  # least share of a view's pixels that a thing must cover
_CUT_OFF = 0.4  # factor for the area of a thing that reaches the picture's edge
_ALPHA_MIN = 0.5


@dataclass(frozen=True)
class _Sight:
    """A thing in a view."""

    worth: float
    view: int
    mask: NDArray[np.bool_] = field(repr=False)


@torch.no_grad()
def with_appearances(
    things: Things,
    gaussians: Gaussians,
    views: Sequence[View],
    encoder: AppearanceEncoder | None,
    max_side: int,
    *,
    looks: ClipImageText | None = None,
    backend: Backend = "cpu",
) -> Things:
    """Adds descriptor, small picture and looks to things, from their largest views.

    Args:
        views: of the capture; at most 16 are used, spread evenly.
        encoder: computes features; None: no descriptors and pictures.
        max_side: pixels of the rendered image's longer side.
        looks: computes embeddings; None: no looks.
    """
    best = _best_sights(things, gaussians, views, max_side, backend)
    features: dict[int, list[NDArray[np.float32]]] = {thing: [] for thing in best}
    embeddings: dict[int, list[NDArray[np.float32]]] = {thing: [] for thing in best}
    pictures: dict[int, bytes] = {}
    for number in sorted({sight.view for sights in best.values() for sight in sights}):
        image = load_image(views[number])
        for thing, sights in best.items():
            for sight in sights:
                if sight.view == number:
                    mask = _enlarged(sight.mask, image.shape[:2])
                    if looks is not None:
                        embeddings[thing].append(looks.embed(image, mask))
                    if encoder is not None:
                        features[thing].append(encoder.features(image, mask))
                    if encoder is not None and sight is sights[0]:
                        pictures[thing] = small_picture(image, mask)

    def described(thing: Thing) -> Thing:
        if features.get(thing.id):
            appearance = descriptor_of(features[thing.id]).tobytes()
            thing = replace(thing, appearance=appearance, picture=pictures[thing.id])
        if looks is not None and embeddings.get(thing.id):
            mean = np.mean(embeddings[thing.id], axis=0)
            embedding = (mean / np.linalg.norm(mean)).astype(np.float16).tobytes()
            thing = replace(thing, looks=Looks(looks.sha256, embedding))
        return thing

    return replace(things, table=tuple(map(described, things.table)))


def _best_sights(
    things: Things, gaussians: Gaussians, views: Sequence[View], max_side: int, backend: Backend
) -> Mapping[int, Sequence[_Sight]]:
    """Maps thing ids to their best views, the best first."""
    device = device_of(backend)
    splats = splats_of(gaussians, device=device)
    classes = max((thing.id for thing in things.table), default=0) + 1
    blend = things_blend(things, gaussians.codes, device)
    sights: dict[int, list[_Sight]] = {}
    for number in spread(len(views), _MAX_VIEWS):
        camera = training_size(views[number].posed.camera, max_side)
        viewmat = torch.from_numpy(views[number].posed.camera_from_world().astype(np.float32)).to(device)
        drawn = blend.render(splats, viewmat, camera, alpha_min=_ALPHA_MIN, relevancy=None, backend=backend)
        owner = drawn.classes.cpu().numpy()
        areas = np.bincount(owner.ravel(), minlength=classes)
        edge = {*owner[0], *owner[-1], *owner[:, 0], *owner[:, -1]}
        for thing in things.table:
            if areas[thing.id] >= _LEAST_SHARE * owner.size:
                worth = float(areas[thing.id]) * (_CUT_OFF if thing.id in edge else 1.0)
                seen = [*sights.get(thing.id, ()), _Sight(worth, number, owner == thing.id)]
                sights[thing.id] = sorted(seen, key=lambda sight: -sight.worth)[:_BEST]
    return sights


def _enlarged(mask: NDArray[np.bool_], size: tuple[int, ...]) -> NDArray[np.bool_]:
    return cv2.resize(mask.astype(np.uint8), (size[1], size[0]), interpolation=cv2.INTER_NEAREST) > 0
