"""Text lines of pictures by PP-OCR, and its opening by its name in the settings.

A DBNet (Liao et al. 2020) gives the probability of a line's shrunk area per pixel; a recognizer reads lines 48 pixels
high by CTC (Graves et al. 2006): repeated characters are one, unless a blank is between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.models.model_files import checked_file
from fastsplat.service.perception.models.model_manifest import find_model
from fastsplat.service.perception.onnx_session import check_contract, open_session
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Image, Writing
from fastsplat_contract.errors import ModelUnavailableError

F32 = NDArray[np.float32]

_STRIDE = 32
_MOST_PIXELS = 4_000_000  # larger pictures are reduced to this many, as memory and time grow with them
_INNER = 0.3  # least probability of a pixel of a line
_LINE = 0.6  # least mean probability of a line's inner area
_UNCLIP = 1.6  # area times this over the perimeter is the margin around the inner area (DBNet, section 3.3)
_LEAST_SIDE_PX = 3.0
_MOST_LINES = 200  # most lines of a picture, the clearest ones
_HEIGHT = 48
_MOST_WIDTH = 1_600
_BATCH_WIDTH = 4_800  # most columns of one run of the recognizer, shared by short lines
_STANDING = 1.5  # height over width from which a line is vertical
_TURNED_BELOW = 0.9  # lines read with less probability are also tried upside down


def open_reader(settings: PerceptionSettings, models: Path) -> PpOcr:
    """Opens the reader of `settings.reader`; raises `ModelUnavailableError` if that fails."""
    name = settings.reader
    _, inside = find_model(name, "reader")
    detector, recognizer = (checked_file(models / inside / file, name=name) for file in PpOcr.FILES)
    return PpOcr(detector, recognizer, name=name, threads=settings.threads)


def find_reader(settings: PerceptionSettings, models: Path) -> PpOcr | None:
    """Opens the reader of `settings.reader`; None if it is unset or was never fetched."""
    if not settings.reader:
        return None
    _, inside = find_model(settings.reader, "reader")
    return open_reader(settings, models) if (models / inside).is_dir() else None


class PpOcr:
    """Adapter of PP-OCR's detector and recognizer.

    Detector `x` [N, 3, H, W] → [N, 1, H, W]; recognizer `x` [N, 3, 48, W] → [N, T, C + 2] of C characters, listed in
    its metadata `character`, one a line; class 0 is the blank, the last one a space. Opening raises
    `ModelUnavailableError` if a file is missing, damaged, or breaks this contract.
    """

    FILES = ("detection.onnx", "recognition.onnx")
    """Names in the model's folder."""

    def __init__(self, detector: Path, recognizer: Path, *, name: str, threads: int = 0) -> None:
        self._detector = open_session(detector, name=name, threads=threads)
        self._recognizer = open_session(recognizer, name=name, threads=threads)
        known = self._recognizer.get_modelmeta().custom_metadata_map.get("character", "")
        if not known:
            raise ModelUnavailableError(
                f"model {name}: {recognizer.name} does not say which characters it reads",
                field=name,
                hint='Use an export of PP-OCR whose metadata has "character", one a line.',
            )
        self._characters = np.array(["", *known.removesuffix("\n").split("\n"), " "])
        check_contract(self._detector, name=name, inputs={"x": (None, 3, None, None)}, outputs=[(None, 1, None, None)])
        classes = len(self._characters)
        check_contract(
            self._recognizer, name=name, inputs={"x": (None, 3, None, None)}, outputs=[(None, None, classes)]
        )

    def read(self, image: Image) -> list[Writing]:
        """Reads the lines of a picture, clearest first; their probability is their characters' least."""
        corners = self._lines(image)
        upright = [_cut_out(image, quad) for quad in corners]
        texts = self._texts(upright)
        unsure = [at for at, (_, probability) in enumerate(texts) if probability < _TURNED_BELOW]
        turned = self._texts([np.ascontiguousarray(upright[at][::-1, ::-1]) for at in unsure])
        for at, reading in zip(unsure, turned, strict=True):
            texts[at] = max(texts[at], reading, key=lambda candidate: candidate[1])
        found = zip(texts, corners, strict=True)
        return [Writing("text", text, probability, quad) for (text, probability), quad in found if text]

    def _lines(self, image: Image) -> list[F32]:
        """Corners of each line, float32 [4, 2] pixels, beginning with its likely top side."""
        height, width = image.shape[:2]
        scale = min(1.0, (_MOST_PIXELS / (height * width)) ** 0.5)
        size = [max(1, round(side * scale / _STRIDE)) * _STRIDE for side in (width, height)]
        how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        text_map = self._detector.run(
            None, {"x": _tensor(np.asarray(cv2.resize(image, size, interpolation=how), np.uint8))}
        )[0][0, 0]
        outlines, _ = cv2.findContours((text_map > _INNER).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
        lines: list[tuple[float, F32]] = []
        to_image = np.array([width / size[0], height / size[1]], np.float32)
        for outline in outlines:
            middle, sides, angle = cv2.minAreaRect(outline)
            if min(sides) < _LEAST_SIDE_PX or (clear := _mean_inside(text_map, outline)) < _LINE:
                continue
            reach = 2 * _UNCLIP * sides[0] * sides[1] / (2 * (sides[0] + sides[1]))
            box = cv2.boxPoints((middle, (sides[0] + reach, sides[1] + reach), angle))
            lines.append((clear, _from_top_left(np.asarray(box, np.float32) * to_image)))
        return [corners for _, corners in sorted(lines, key=lambda line: -line[0])[:_MOST_LINES]]

    def _texts(self, lines: Sequence[Image]) -> list[tuple[str, float]]:
        """Recognizes text and probability of pictures of lines, 48 pixels high."""
        texts: list[tuple[str, float]] = [("", 0.0)] * len(lines)
        order = sorted(range(len(lines)), key=lambda at: lines[at].shape[1])
        while order:
            widest = lines[order[-1]].shape[1]
            indices = order[-max(1, _BATCH_WIDTH // widest) :]
            del order[-len(indices) :]
            batch = np.concatenate([_tensor(lines[at], widest) for at in indices])
            for at, row in zip(indices, self._recognizer.run(None, {"x": batch})[0], strict=True):
                texts[at] = self._decoded(row)
        return texts

    def _decoded(self, row: F32) -> tuple[str, float]:
        best = row.argmax(axis=1)
        mask = (best > 0) & np.append(True, best[1:] != best[:-1])
        text = "".join(self._characters[best[mask]]).strip()
        return text, float(row.max(axis=1)[mask].min()) if text else 0.0


def _tensor(image: Image, width: int = 0) -> F32:
    """float32 [1, 3, H, max(W, width)] in -1..1, zeros beyond the picture."""
    pixels = image[..., ::-1].astype(np.float32).transpose(2, 0, 1) / 127.5 - 1  # trained on OpenCV's BGR
    return np.ascontiguousarray(np.pad(pixels, ((0, 0), (0, 0), (0, max(0, width - image.shape[1]))))[None])


def _mean_inside(text_map: F32, outline: NDArray[np.int32]) -> float:
    left, top, width, height = cv2.boundingRect(outline)
    inside = cv2.drawContours(np.zeros((height, width), np.uint8), [outline - (left, top)], 0, 1, cv2.FILLED)
    return float(cv2.mean(text_map[top : top + height, left : left + width], inside)[0])


def _from_top_left(box: F32) -> F32:
    """Sorts corners clockwise from the top left."""
    by_x = box[np.argsort(box[:, 0], kind="stable")]
    left, right = (side[np.argsort(side[:, 1], kind="stable")] for side in (by_x[:2], by_x[2:]))
    return np.stack([left[0], right[0], right[1], left[1]])


def _cut_out(image: Image, corners: F32) -> Image:
    """uint8 [48, W, 3]: rectifies a quadrilateral; a vertical one is turned."""
    width, height = (float(np.linalg.norm(corners[side] - corners[0])) for side in (1, 3))
    if height > _STANDING * width:
        corners, width, height = np.roll(corners, -1, axis=0), height, width
    columns = int(np.clip(round(width * _HEIGHT / max(height, 1.0)), 1, _MOST_WIDTH))
    target = np.array([[0, 0], [columns, 0], [columns, _HEIGHT], [0, _HEIGHT]], np.float32)
    matrix = cv2.getPerspectiveTransform(corners.astype(np.float32), target)
    straight = cv2.warpPerspective(
        image, matrix, (columns, _HEIGHT), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(straight, np.uint8)
