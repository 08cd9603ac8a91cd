"""Checks videos and extracts sharp frames. Runs only in the child of `capture.untrusted.sandbox`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.formats.reduced_images import limited
from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_SHARPNESS_SIDE = 480
_MIN_FRAMES = 2
_MAX_PLAUSIBLE_FPS = 1_000


def probe(request: dict[str, Any]) -> dict[str, Any]:
    """Reads the size of a video's first frame and checks its length without decoding.

    Args:
        request: the path "video", its "name" in errors, and all settings.

    Returns:
        {"width", "height"} in pixels.

    Raises:
        InvalidInputError: the first frame cannot be decoded, or there are fewer than two.
        LimitExceededError: more than "max_video_frames_read" frames, or frames larger than "max_image_pixels".
    """
    first = next(_frames(request), None)
    if first is None:
        raise _unreadable(request)
    _check_frame_count(request)
    return {"width": first.shape[1], "height": first.shape[0]}


def extract(request: dict[str, Any], report: Callable[[float, str], None]) -> dict[str, Any]:
    """Writes the sharpest frame of each of "video_frames" equal intervals, upright, to "folder".

    Sharpness is the variance of the Laplacian; with "by_place" the middle frame is taken. Files are frame_NNNNNN.png by
    frame number, at most "max_side" pixels on the longer side.

    Args:
        request: as in `probe`, with "folder" and "by_place".

    Returns:
        {"files": names in time order, "size": [width, height] of the first, "read": frames in the video}.

    Raises:
        InvalidInputError: fewer than two frames can be decoded.
        LimitExceededError: more than "max_video_frames_read" frames, or frames larger than "max_image_pixels".
    """
    sharpness = []
    for number, frame in enumerate(_frames(request)):
        sharpness.append(0.0 if request["by_place"] else _sharpness(frame))
        if number % 50 == 0:
            report(0.5, f"looking for sharp frames {number}")
    if len(sharpness) < _MIN_FRAMES:
        raise _unreadable(request)
    intervals = request["video_frames"]
    if request["by_place"]:
        numbers = middle_per_interval(len(sharpness), intervals)
    else:
        numbers = sharpest_per_interval(np.array(sharpness), intervals)
    files: list[str] = []
    size: tuple[int, int] | None = None
    for number, frame in enumerate(_frames(request)):
        if number in numbers:
            reduced = limited(frame, request["max_side"])
            size = size or (reduced.shape[1], reduced.shape[0])
            files.append(f"frame_{number:06d}.png")
            cv2.imwrite(str(Path(request["folder"]) / files[-1]), reduced)
            report(0.5 + 0.5 * len(files) / len(numbers), f"writing frames {len(files)}/{len(numbers)}")
    return {"files": files, "size": size, "read": len(sharpness)}


def sharpest_per_interval(sharpness: NDArray[np.float64], intervals: int) -> set[int]:
    """Finds the largest value's index in each of up to `intervals` equal parts."""
    return {int(part[np.argmax(sharpness[part])]) for part in _parts(len(sharpness), intervals)}


def middle_per_interval(count: int, intervals: int) -> set[int]:
    """Finds the middle index of each of up to `intervals` equal parts."""
    return {int(part[len(part) // 2]) for part in _parts(count, intervals)}


def _parts(count: int, intervals: int) -> list[NDArray[np.int64]]:
    return np.array_split(np.arange(count), min(intervals, count))


def _check_frame_count(request: dict[str, Any]) -> None:
    """Counts the packets, one a frame, as headers may be wrong or incomplete."""
    capture = cv2.VideoCapture(request["video"], cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])  # -1: do not decode
    if not capture.isOpened():
        capture = cv2.VideoCapture(request["video"])
    try:
        fps, count = capture.get(cv2.CAP_PROP_FPS), 0
        while capture.grab():
            count += 1
            if count > request["max_video_frames_read"]:
                raise _too_long(request, fps)
    finally:
        capture.release()
    if count < _MIN_FRAMES:
        raise _unreadable(request)


def _frames(request: dict[str, Any]) -> Iterator[NDArray[np.uint8]]:
    """Decodes uint8 [H, W, 3] BGR frames, rotated by the file's metadata."""
    capture = cv2.VideoCapture(request["video"])
    try:
        count = 0
        while True:
            decoded, frame = capture.read()
            if not decoded:
                return
            if frame.shape[0] * frame.shape[1] > request["max_image_pixels"]:
                raise LimitExceededError(
                    f"{request['name']} has frames of {frame.shape[1]}×{frame.shape[0]} pixels",
                    field=request["name"],
                    limit=f"{request['max_image_pixels']} pixels a frame (FASTSPLAT_CAPTURE__MAX_IMAGE_PIXELS)",
                    hint="Send a smaller version.",
                )
            count += 1
            if count > request["max_video_frames_read"]:
                raise _too_long(request, capture.get(cv2.CAP_PROP_FPS))
            yield np.asarray(frame, dtype=np.uint8)
    finally:
        capture.release()


def _sharpness(frame: NDArray[np.uint8]) -> float:
    gray = cv2.cvtColor(limited(frame, _SHARPNESS_SIDE), cv2.COLOR_BGR2GRAY)
    return float(cv2.Laplacian(gray, cv2.CV_64F).var())


def _too_long(request: dict[str, Any], fps: float) -> LimitExceededError:
    limit = request["max_video_frames_read"]
    duration = f", which is {limit / fps:.0f} s at its frame rate" if 0 < fps < _MAX_PLAUSIBLE_FPS else ""
    return LimitExceededError(
        f"{request['name']} is too long: it has more than {limit} frames{duration}",
        field=request["name"],
        limit=f"{limit} frames",
        hint="Cut it to the walk around the scene, or export it at a lower frame rate.",
    )


def _unreadable(request: dict[str, Any]) -> InvalidInputError:
    return InvalidInputError(
        f"{request['name']} has no frames that can be decoded",
        field=request["name"],
        hint="Send an MP4 (H.264), MOV, WebM, MKV or AVI file of at least two frames.",
    )
