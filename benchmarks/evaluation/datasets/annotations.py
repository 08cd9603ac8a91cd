"""Open-vocabulary masks of single frames, as LERF-OVS, LERF-Mask and 3D-OVS ship them.

The layouts are those that public loaders of the sets expect: of LERF-OVS `eval_gt_lerfdata` in LangSplat's
`eval/evaluate_iou_loc.py` (github.com/minghanqin/LangSplat, commit 26ed214), of 3D-OVS `LLFFDataset` in
`dataLoader/llff.py` (github.com/Kunhao-Liu/3D-OVS, commit 80e512c) and `eval_gt_3dovsdata` in Occam's LGS'
`eval/evaluate_iou_3dovs.py` (read in github.com/Shu1L0n9/OccamLGS, commit 70d2e69), of LERF-Mask `readColmapSceneInfo`
and `script/eval_lerf_mask.py` of github.com/lkeab/gaussian-grouping, commit 296898a. Two things differ. LangSplat's
loader finds the image of a frame by the number in its name, as a position; here it is the image of that name. And
boxes are the tightest around the polygons, not the file's `bbox`, which need not survive a lens' correction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluation.datasets.dataset import Kind
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.bounded_json import read_json
from fastsplat.service.capture.formats.image_io import load_stored
from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_WHITE = 127
_MAX_TEXT = 200
_LABELME_HINT = "Each object needs a category (or label) and a polygon of at least 3 points [x, y]."


@dataclass(frozen=True)
class Annotation:
    """One text in one frame.

    Attributes:
        text: what is shown.
        instances: bool [H, W] masks at the size the annotation was drawn at.
    """

    text: str
    instances: tuple[NDArray[np.bool_], ...]


@dataclass(frozen=True)
class Annotations:
    """All annotated frames of a scene.

    Attributes:
        kind: where the format comes from.
        texts: every text, in the data set's order.
        frames: by the frame's name, which is its image's name without extension; of 3D-OVS it may be the position of
            its image among all, from 0, where no image has such a name; of LERF-Mask it is the position of its image
            among those that are not in `images_train`.
        notes: what was left aside, as sentences for people.
    """

    kind: Kind
    texts: tuple[str, ...]
    frames: Mapping[str, tuple[Annotation, ...]]
    notes: tuple[str, ...] = ()


def find_annotations(folder: Path, settings: CaptureSettings) -> Annotations | None:
    """LERF-OVS: `label/<scene>/<frame>.json` beside the scene's folder (or `label/<frame>.json` in it); LERF-Mask:
    `test_mask/<frame>/<text>.png`; 3D-OVS: `segmentations/classes.txt` and `segmentations/<frame>/<label>.png`. None
    when there is none of them.

    Raises:
        InvalidInputError: the annotations are malformed; the message names the file.
        LimitExceededError: a frame of more pixels than the settings allow.
    """
    for labels in (folder / "label", folder.parent / "label" / folder.name, folder / "label" / folder.name):
        frames = sorted(labels.glob("*.json"))
        if frames:
            return _lerf_ovs(frames, settings)
    if (folder / "test_mask").is_dir():
        return _lerf_mask(folder, settings)
    if (folder / "segmentations" / "classes.txt").is_file():
        return _three_d_ovs(folder, settings)
    return None


def _lerf_ovs(files: list[Path], settings: CaptureSettings) -> Annotations:
    frames = {file.stem: _lerf_frame(file, settings) for file in files}
    texts = sorted({annotation.text for frame in frames.values() for annotation in frame})
    if not texts:
        raise InvalidInputError(
            f"{files[0].parent.name}: no frame has an annotated object", field=files[0].name, hint=_LABELME_HINT
        )
    return Annotations("lerf_ovs", tuple(texts), frames)


def _lerf_frame(file: Path, settings: CaptureSettings) -> tuple[Annotation, ...]:
    """LangSplat's LERF-OVS files say info.width/height and objects[].category/segmentation; labelme itself says
    imageWidth/imageHeight and shapes[].label/points."""
    document = read_json(file, file.name, settings)
    if not isinstance(document, dict):
        raise _malformed(file, "it is no object")
    info = document.get("info")
    stated = info if isinstance(info, dict) else {}
    image = stated.get("name", file.name)
    if not isinstance(image, str) or PurePosixPath(image).stem != file.stem:
        raise _malformed(file, f"it is of another image, {str(image)[:80]}")
    width = _side(file, stated.get("width", document.get("imageWidth")))
    height = _side(file, stated.get("height", document.get("imageHeight")))
    if width * height > settings.max_image_pixels:
        raise LimitExceededError(
            f"{file.name} annotates {width}×{height} pixels",
            field=file.name,
            limit=f"{settings.max_image_pixels} pixels an image (FASTSPLAT_CAPTURE__MAX_IMAGE_PIXELS)",
            hint="Check its width and height.",
        )
    objects = document.get("objects", document.get("shapes"))
    if not isinstance(objects, list):
        raise _malformed(file, "it has no list of objects")
    masks: dict[str, list[NDArray[np.bool_]]] = {}
    for number, obj in enumerate(objects):
        text = obj.get("category", obj.get("label")) if isinstance(obj, dict) else None
        if not isinstance(text, str) or not text.strip() or len(text) > _MAX_TEXT:
            raise _malformed(file, f"object {number} has no category")
        if obj.get("shape_type", "polygon") != "polygon":
            raise _malformed(file, f"object {number} is a {str(obj['shape_type'])[:40]}, which is no mask")
        for polygon in _polygons(obj.get("segmentation", obj.get("points")), file, number):
            masks.setdefault(text.strip(), []).append(_filled(polygon, width, height))
    return tuple(Annotation(text, tuple(instances)) for text, instances in masks.items())


def _side(file: Path, stated: Any) -> int:
    if type(stated) is not int or stated < 1:
        raise _malformed(file, f"its image's width or height is {str(stated)[:40]}")
    return stated


def _polygons(stated: Any, file: Path, number: int) -> Iterator[NDArray[np.float64]]:
    """One polygon [[x, y], ...], or a list of such."""
    nested = isinstance(stated, list) and stated and isinstance(stated[0], list) and stated[0]
    several = stated if nested and isinstance(nested[0], list) else [stated]
    for polygon in several:
        points = polygon if isinstance(polygon, list) else []
        fits = all(isinstance(point, list) and len(point) == 2 and all(map(_is_coordinate, point)) for point in points)
        if len(points) < 3 or not fits:
            raise _malformed(file, f"object {number} has no polygon")
        yield np.array(points, np.float64)


def _is_coordinate(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and abs(value) < 1e6


def _filled(polygon: NDArray[np.float64], width: int, height: int) -> NDArray[np.bool_]:
    mask = np.zeros((height, width), np.uint8)
    # Coordinates count from the image's corner; OpenCV's from the first pixel's centre.
    cv2.fillPoly(mask, [np.round(polygon - 0.5).astype(np.int32)], 1)
    return mask.astype(np.bool_)


def _lerf_mask(folder: Path, settings: CaptureSettings) -> Annotations:
    frames = {
        frame.name: tuple(
            Annotation(path.stem.strip(), _one_mask(folder, path.relative_to(folder).as_posix(), settings))
            for path in sorted(frame.glob("*.png"))
        )
        for frame in sorted((folder / "test_mask").iterdir())
        if frame.is_dir()
    }
    texts = sorted({annotation.text for frame in frames.values() for annotation in frame})
    if not texts:
        raise InvalidInputError(
            "test_mask/ has no masks", field="test_mask", hint="Write test_mask/<frame>/<text>.png."
        )
    return Annotations("lerf_mask", tuple(texts), frames)


def _three_d_ovs(folder: Path, settings: CaptureSettings) -> Annotations:
    root = folder / "segmentations"
    try:
        lines = (root / "classes.txt").read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise InvalidInputError(f"segmentations/classes.txt: {error}", field="classes.txt", hint=_CLASSES) from error
    texts = tuple(line.strip() for line in lines if line.strip())
    if not texts or len(set(texts)) < len(texts):
        raise InvalidInputError(
            "segmentations/classes.txt is empty or names a class twice", field="classes.txt", hint=_CLASSES
        )
    frames, strangers = {}, set()
    for frame in sorted(path for path in root.iterdir() if path.is_dir()):
        files = {path.stem.strip(): path for path in sorted(frame.glob("*.png"))}
        missing = sorted(set(texts) - set(files))
        if missing:
            raise InvalidInputError(
                f"segmentations/{frame.name}: {missing[0][:80]!r} has no mask",
                field=f"segmentations/{frame.name}",
                hint="Every frame needs one <label>.png for each line of classes.txt; an empty one where it is unseen.",
            )
        strangers |= set(files) - set(texts)
        frames[frame.name] = tuple(
            Annotation(text, _one_mask(folder, files[text].relative_to(folder).as_posix(), settings)) for text in texts
        )
    if not frames:
        raise InvalidInputError("segmentations/ has no frames", field="segmentations", hint=_CLASSES)
    notes = tuple(
        f"segmentations/*/{name[:80]}.png is in no classes.txt and was left out." for name in sorted(strangers)
    )
    return Annotations("3d_ovs", texts, frames, notes)


def _one_mask(folder: Path, name: str, settings: CaptureSettings) -> tuple[NDArray[np.bool_], ...]:
    mask = load_stored(folder, name, settings).max(axis=2) > _WHITE
    return (mask,) if mask.any() else ()


_CLASSES = "Write one class a line, and masks as segmentations/<frame>/<class>.png."


def _malformed(file: Path, problem: str) -> InvalidInputError:
    return InvalidInputError(f"{file.name}: {problem}", field=file.name, hint=_LABELME_HINT)
