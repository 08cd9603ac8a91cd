"""Saves and loads captures: `capture.json`, `points.safetensors`, and the views' files by relative paths."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from safetensors.numpy import load_file

from fastsplat.service.capture.captures import Capture, CaptureReport, GivenLabels, SensorDepth, View
from fastsplat.service.common.array_files import write_arrays
from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.common.radial_lens import RadialLens
from fastsplat_contract.codec.json_codec import from_plain, to_plain
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.camera import Camera, PosedCamera

_VERSION = 1
_CAPTURE = "capture.json"
_POINTS = "points.safetensors"


def save_capture(capture: Capture, folder: Path) -> None:
    """Writes a capture except the views' own files, which are below `folder` already."""
    write_arrays({"points": capture.points, "point_colors": capture.point_colors}, folder / _POINTS)
    labels = capture.given_labels
    document: dict[str, Any] = {
        "version": _VERSION,
        "scale": capture.scale,
        "report": to_plain(capture.report),
        "test_names": capture.test_names,
        "views": [_view_to_json(view, folder) for view in capture.views],
        "splat": _relative(capture.splat, folder),
        "given_labels": None
        if labels is None
        else {
            "entries": [asdict(entry) for entry in labels.dictionary.entries],
            "maps": [_relative(path, folder) for path in labels.map_paths],
        },
    }
    (folder / _CAPTURE).write_text(json.dumps(document))


def holds_capture(folder: Path) -> bool:
    """Checks for a capture in a folder."""
    return (folder / _CAPTURE).is_file()


def load_capture(out_dir: Path) -> Capture:
    """Loads the capture that `build_capture` wrote.

    Raises:
        NotFoundError: there is no capture.
        InvalidInputError: it is of another version, or damaged.
    """
    path = out_dir / _CAPTURE
    if not path.is_file():
        raise NotFoundError("there is no capture here", field="capture", hint="Build it from the upload again.")
    try:
        document = json.loads(path.read_text())
        if document["version"] != _VERSION:
            raise InvalidInputError(
                f"{path.name} has version {document['version']}, expected {_VERSION}",
                field="capture",
                hint="Build it again.",
            )
        arrays = load_file(out_dir / _POINTS)
        return Capture(
            views=tuple(_view_from_json(view, out_dir) for view in document["views"]),
            points=arrays["points"],
            point_colors=arrays["point_colors"],
            scale=document["scale"],
            report=from_plain(CaptureReport, document["report"]),
            given_labels=_given_labels(document["given_labels"], out_dir),
            test_names=tuple(document["test_names"]),
            splat=None if document["splat"] is None else out_dir / document["splat"],
        )
    except (KeyError, TypeError, ValueError, OSError) as error:
        raise InvalidInputError(
            f"{path.name} is damaged: {error}", field="capture", hint="Build it from the upload again."
        ) from error


def load_content(view: View) -> NDArray[np.bool_] | None:
    """Loads the mask of usable pixels, bool [H, W]; None if all are usable."""
    if view.valid_path is None:
        return None
    with Image.open(view.valid_path) as picture:
        return np.asarray(picture.convert("L")) >= 128


def _view_to_json(view: View, folder: Path) -> dict[str, Any]:
    return {
        "name": view.posed.name,
        "camera": asdict(view.posed.camera),
        "world_from_camera": view.posed.world_from_camera.tolist(),
        "image": _relative(view.image_path, folder),
        "valid": _relative(view.valid_path, folder),
        "depth": None
        if view.depth is None
        else {"map": _relative(view.depth.path, folder), "camera": asdict(view.depth.camera), "unit": view.depth.unit},
        "exposure_ev": view.exposure_ev,
        "taken_at": view.taken_at,
        "lens": None if view.lens is None else asdict(view.lens),
    }


def _view_from_json(stored: dict[str, Any], folder: Path) -> View:
    pose = np.array(stored["world_from_camera"], dtype=np.float64)
    posed = PosedCamera(Camera(**stored["camera"]), pose, stored["name"])
    valid, depth, lens = stored["valid"], stored["depth"], stored["lens"]
    return View(
        posed,
        folder / stored["image"],
        None if valid is None else folder / valid,
        None if depth is None else SensorDepth(folder / depth["map"], Camera(**depth["camera"]), depth["unit"]),
        stored["exposure_ev"],
        stored["taken_at"],
        None if lens is None else RadialLens(**lens),
    )


def _given_labels(stored: dict[str, Any] | None, folder: Path) -> GivenLabels | None:
    if stored is None:
        return None
    entries = tuple(DictionaryEntry(**{**entry, "aliases": tuple(entry["aliases"])}) for entry in stored["entries"])
    return GivenLabels(Dictionary(entries), tuple(None if path is None else folder / path for path in stored["maps"]))


def _relative(path: Path | None, folder: Path) -> str | None:
    return None if path is None else path.relative_to(folder).as_posix()
