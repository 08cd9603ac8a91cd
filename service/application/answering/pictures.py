"""Renders a view of a scene as a picture or array file."""

from __future__ import annotations

from io import BytesIO
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from fastsplat.service.application.base.validate import check_viewpoint
from fastsplat.service.query.drawing import pictures
from fastsplat.service.query.language.words.query_text import TextQuery
from fastsplat.service.query.objects.object_index import SceneObjects
from fastsplat.service.query.ranked_scene import RankedQuery, RankedScene
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.photos.pictures import PictureKind, PictureRequest

_ASKING: tuple[PictureKind, ...] = ("overlay", "relevancy", "mask")
_ARRAYS: tuple[PictureKind, ...] = ("label_map", "object_map", "depth", "normals", "confidence")
_EXACT: tuple[PictureKind, ...] = ("mask", *_ARRAYS)
"""Kinds whose values carry meaning, so that no format may change them."""
DEPTH_SCALE = 0.001
_FARTHEST = 65_535


def question_of(request: PictureRequest) -> str:
    """Validates a picture request; returns its text, "" for kinds without one.

    Raises:
        InvalidInputError: both or neither of camera and view, an unknown kind, a missing text, "npy" for a picture,
            JPEG for exact values, an invalid depth scale, or tints or coarse for another kind than rgb.
    """
    check_viewpoint("picture", request.camera, request.view)
    kind, kinds = request.kind, get_args(PictureKind)
    if kind not in kinds:
        named = ", ".join(f'"{known}"' for known in kinds)
        raise InvalidInputError(f"no picture of kind {kind[:40]!r}", field="kind", hint=f"Use one of {named}.")
    if kind in _ASKING and not request.text:
        raise InvalidInputError(f'a picture of kind "{kind}" needs a text', field="text")
    if request.format == "npy" and kind not in _ARRAYS:
        raise InvalidInputError(
            f'"{kind}" is a picture, not an array', field="format", hint=f'Use "png", or ask for {", ".join(_ARRAYS)}.'
        )
    if request.format == "jpeg" and kind in _EXACT:
        raise InvalidInputError(
            f'JPEG would change the values of "{kind}"', field="format", hint='Use "png", which keeps them.'
        )
    if kind != "rgb" and (request.tints or request.dimming):
        raise InvalidInputError(
            f'tints and dimming on a picture of kind "{kind}"',
            field="tints" if request.tints else "dimming",
            hint='They are for "rgb".',
        )
    if kind != "rgb" and request.coarse:
        raise InvalidInputError(f'a coarse picture of kind "{kind}"', field="coarse", hint='It is for "rgb".')
    if not (np.isfinite(request.depth_scale) and request.depth_scale >= 0):
        raise InvalidInputError(
            f"a depth scale of {request.depth_scale}",
            field="depth_scale",
            hint="Scene units a step, above 0; 0.001 is usual.",
        )
    return request.text or "" if kind in _ASKING else ""


def picture(index: SceneIndex, ranked: RankedScene, request: PictureRequest, query: TextQuery | None) -> bytes:
    """Encodes one picture of a request that passed `question_of`, which gave `query`.

    Raises:
        NotFoundError: no such view, or no such tinted object.
    """
    posed = index.viewpoint(request.camera, request.view)
    kind, image_format = request.kind, request.format
    if kind in ("label_map", "object_map"):
        ids = index.label_map(posed) if kind == "label_map" else index.object_map(posed)
        return _npy(ids) if image_format == "npy" else _png16(ids)
    if kind == "depth":
        depth = index.depth(posed)
        return _npy(depth) if image_format == "npy" else _depth_png(depth, request.depth_scale or DEPTH_SCALE)
    if kind in ("normals", "confidence"):
        seen = index.geometry(posed)
        if image_format == "npy":
            return _npy(seen.normals if kind == "normals" else seen.confidence)
        if kind == "normals":
            colored = np.asarray(np.rint((seen.normals + 1) * 127.5), np.uint8)  # black without a surface
            colored[~seen.normals.any(axis=-1)] = 0
            return pictures.png_bytes(colored)
        return _png16(np.rint(seen.confidence.clip(0, 1) * _FARTHEST).astype(np.uint16))
    image = _image(index, ranked, posed, request, query)
    return pictures.jpeg_bytes(image) if image_format == "jpeg" else pictures.png_bytes(image)


def _image(
    index: SceneIndex, ranked: RankedScene, posed: PosedCamera, request: PictureRequest, query: TextQuery | None
) -> pictures.U8:
    """uint8 [H, W, 3], or [H, W] for a mask."""
    if request.kind == "rgb":
        drawn = index.coarse if request.coarse else index
        rgb = drawn.render(posed)
        return _tinted(index, drawn.objects, posed, rgb, request) if request.tints or request.dimming else rgb
    if request.kind == "objects":
        by_id = {obj.id: obj.name for obj in index.objects.present}
        return pictures.objects_picture(index.render(posed), index.object_map(posed), by_id)
    if request.kind == "depth_picture":
        return _depth_picture(index.depth(posed))
    assert query is not None
    pose = posed.world_from_camera  # "left of" is as in this picture
    (answer,) = RankedQuery(ranked, query).answer(lambda: index.objects, pose)
    mask2d = index.mask2d(answer, posed)
    if request.kind == "mask":
        return np.asarray(mask2d.mask.astype(np.uint8) * 255)
    if request.kind == "relevancy":
        return pictures.relevancy_picture(mask2d.rgb, mask2d.relevancy)
    names = [(match.label_id, match.label) for match in answer.matches if match.relevant]
    return pictures.named_overlay(mask2d.rgb, mask2d.mask, mask2d.label_ids, names)


def _tinted(
    index: SceneIndex, drawn: SceneObjects, posed: PosedCamera, rgb: pictures.U8, request: PictureRequest
) -> pictures.U8:
    """Applies the request's tints; `drawn` shows the scene's objects."""
    objects = index.objects
    tints = [
        tint._replace(object_ids=objects.with_members(tint.object_ids, field=f"tints[{number}].object_ids"))
        for number, tint in enumerate(request.tints)
    ]
    ids = drawn.map(posed)
    tinted = {object_id for tint in tints for object_id in tint.object_ids}
    if parts := [part.id for part in objects.present_parts if part.id in tinted]:
        of_parts = drawn.part_map(posed)
        ids = np.where(np.isin(of_parts, parts), of_parts, ids)
    return pictures.tinted_picture(rgb, ids, tints, request.dimming)


def _depth_png(depth: NDArray[np.float32], scale: float) -> bytes:
    """16-bit steps of `scale`: 0 is empty, 65535 means this far or farther."""
    steps = np.clip(np.rint(depth.astype(np.float64) / scale), 1, _FARTHEST)
    return _png16(np.where(depth > 0, steps, 0).astype(np.uint16), {"depth_scale": repr(scale)})


def _depth_picture(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Turbo colors over the present depths: near is red, empty is black."""
    there = depth > 0
    if not there.any():
        return np.zeros((*depth.shape, 3), dtype=np.uint8)
    near, far = depth[there].min(), depth[there].max()
    coloured = pictures.turbo((far - depth) / max(far - near, 1e-9))
    coloured[~there] = 0
    return coloured


def _png16(values: NDArray[np.uint16], texts: dict[str, str] | None = None) -> bytes:
    info = PngImagePlugin.PngInfo()
    for name, text in (texts or {}).items():
        info.add_text(name, text)
    file = BytesIO()
    Image.fromarray(np.ascontiguousarray(values)).save(file, format="PNG", pnginfo=info)
    return file.getvalue()


def _npy(values: NDArray[Any]) -> bytes:
    file = BytesIO()
    np.save(file, values, allow_pickle=False)
    return file.getvalue()
