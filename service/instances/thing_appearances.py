"""What the things of a scene look like in its photos: what they are known by in other scenes of their project."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.capture.build import load_image
from fastsplat.service.capture.types import View
from fastsplat.service.perception.appearance import AppearanceEncoder, descriptor_of, small_picture
from fastsplat.service.perception.capture_detection import spread
from fastsplat.service.perception.image_text import ClipImageText
from fastsplat.service.scene.types import Gaussians, Looks, Thing, Things
from fastsplat.service.splatting.blending import things_blend
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.types import Backend
from fastsplat.service.splatting.training_views import training_size

_MAX_VIEWS = 16
_BEST = 5
"""Views from which a thing is described: measured with 1, 3 and 5."""
_LEAST_SHARE = 0.0015
"""Of a view's pixels that a thing must cover."""
_CUT_OFF = 0.4
"""What a view's area of a thing counts where the thing reaches the picture's edge."""
_ALPHA_MIN = 0.5


@dataclass(frozen=True)
class _Sight:
    """A thing in a view: how well it is seen, and where."""

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
    """The same things, each with its descriptor, a small picture and its looks from the views that show most of it.

    Args:
        views: of the capture; of many, 16 spread evenly.
        encoder: makes the features; None: things get neither descriptor nor picture.
        max_side: things are drawn at this many pixels on the image's longer side.
        looks: embeds what things look like; None: nothing does.
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
    """By thing, its best views, the best first."""
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
