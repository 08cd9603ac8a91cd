"""Photos that are spoiled in many ways, and what they cost the captures that they are in.

`python -m benchmarks.robustness.spoiled_photos [MINUTES] [SEED]` makes captures of 20 good photos of the sample capture
and of the sets below FASTSPLAT_TEST_DATA, and of 3 to 30 % spoiled ones among them, until the minutes are over. It
prints one JSON object: how many captures there were, how many failed, how many good photos lost a place that they have
without the spoiled ones, how many spoiled ones have neither a place nor a reason, in which captures, and what became of
each kind. Works in a temporary folder.
"""

from __future__ import annotations

import io
import json
import os
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import ExifTags, Image

from benchmarks.provenance import ROOT
from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import FastSplatError

Spoil = Callable[[np.ndarray, np.ndarray, np.random.Generator], bytes]
SETTINGS = CaptureSettings(max_side=480, sfm_features=2_000)
_HUGE = 40_000_000
_GOOD = 20


def jpeg(pixels: np.ndarray, **options: object) -> bytes:
    """A photo of uint8 [H, W, 3] pixels."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=92, **options)
    return stream.getvalue()


def exif(focal_35mm: float, orientation: int = 1) -> Image.Exif:
    """Of another phone, with this focal length."""
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation], exif[ExifTags.Base.Model] = orientation, "another"
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = focal_35mm
    return exif


def _through_another_lens(pixels: np.ndarray) -> np.ndarray:
    """As a lens with strong barrel distortion shows it."""
    height, width = pixels.shape[:2]
    x, y = np.meshgrid((np.arange(width) - width / 2) / width, (np.arange(height) - height / 2) / width)
    factor = 1 + 1.5 * (x**2 + y**2)
    left, top = ((part * factor * width + side / 2).astype(np.float32) for part, side in ((x, width), (y, height)))
    return np.asarray(cv2.remap(pixels, left, top, cv2.INTER_LINEAR))


def _forty_megapixels(pixels: np.ndarray) -> bytes:
    scale = (_HUGE / (pixels.shape[0] * pixels.shape[1])) ** 0.5
    return jpeg(np.asarray(cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)))


def narrow_crop(pixels: np.ndarray, rng: np.random.Generator) -> bytes:
    """A narrow, mostly tall piece at one rim, with EXIF or without."""
    height, width = pixels.shape[:2]
    rows, columns = int(height * rng.uniform(0.5, 0.95)), int(width * rng.uniform(0.15, 0.35))
    top, left = rng.choice([0, height - rows]), rng.choice([0, width - columns])
    piece = np.ascontiguousarray(pixels[top : top + rows, left : left + columns])
    return jpeg(piece, exif=exif(rng.choice([24.0, 28.0, 50.0]))) if rng.random() < 0.5 else jpeg(piece)


def _gif(pixels: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "GIF")
    return stream.getvalue()


SPOILED: dict[str, Spoil] = {
    "black": lambda good, foreign, rng: jpeg(np.zeros_like(good)),
    "white": lambda good, foreign, rng: jpeg(np.full_like(good, 255)),
    "noise": lambda good, foreign, rng: jpeg(rng.integers(0, 256, good.shape, np.uint8)),
    "tiny": lambda good, foreign, rng: jpeg(np.asarray(Image.fromarray(good).resize((16, 12)))),
    "blurred": lambda good, foreign, rng: jpeg(np.asarray(cv2.blur(good, (41, 3)))),
    "duplicate": lambda good, foreign, rng: jpeg(good, subsampling=2),
    "rotated": lambda good, foreign, rng: jpeg(np.ascontiguousarray(np.rot90(good))),
    "mirrored": lambda good, foreign, rng: jpeg(np.ascontiguousarray(good[:, ::-1])),
    "foreign": lambda good, foreign, rng: jpeg(foreign),
    "lens": lambda good, foreign, rng: jpeg(_through_another_lens(good)),
    "lying": lambda good, foreign, rng: jpeg(good, exif=exif(300.0)),
    "absurd": lambda good, foreign, rng: jpeg(good, exif=exif(60_000.0, 77)),
    "huge": lambda good, foreign, rng: _forty_megapixels(good),
    "crop": lambda good, foreign, rng: narrow_crop(good, rng),
    "gif": lambda good, foreign, rng: _gif(good),
}
"""How the pixels of a good photo, or a photo of another place, become a spoiled one."""
DAMAGED: dict[str, Callable[[bytes], bytes]] = {
    "truncated": lambda whole: whole[: len(whole) // 3],
    "garbage": lambda whole: whole[:200] + bytes(range(256)) * 20,
    "text": lambda whole: b"This is no photo.\n" * 50,
    "empty": lambda whole: b"",
}
"""How the bytes of a photo become damaged, before or after they were checked."""


def capture_of(
    folder: Path, sent: Mapping[str, bytes], damaged: Mapping[str, bytes], settings: CaptureSettings
) -> Capture:
    """The capture of photos, by name; those of `damaged` become these bytes after the check."""
    images = folder / "upload" / "images"
    images.mkdir(parents=True)
    for name, content in sent.items():
        (images / name).write_bytes(content)
    files = validate_upload(images.parent, settings).folder / "files"
    for name, content in damaged.items():
        path = files / "images" / name
        path.unlink()  # a link to what was sent
        path.write_bytes(content)
    return build_capture(images.parent, folder / "out", settings, silent)


def main(minutes: float, seed: int) -> None:
    """Print what spoiled photos cost."""
    until = time.monotonic() + 60 * minutes
    folders = {"sample": ROOT / "demo/sample/images"}
    if data := os.environ.get("FASTSPLAT_TEST_DATA"):
        folders |= {name: Path(data) / name / "images" for name in ("kitchen", "plush")}
    sets = {name: _thinned(folder) for name, folder in folders.items()}
    counts: Counter[str] = Counter()
    kinds: dict[str, Counter[str]] = defaultdict(Counter)
    failures: list[str] = []
    alone: dict[str, set[str]] = {}
    while not alone or time.monotonic() < until:
        name = list(sets)[counts["captures"] % len(sets)]
        with tempfile.TemporaryDirectory() as folder:
            if name not in alone:
                alone[name] = _placed(capture_of(Path(folder) / "alone", sets[name], {}, SETTINGS))
            other_photos = [photo for other_name in sets if other_name != name for photo in sets[other_name].values()]
            rng = np.random.default_rng([seed, counts["captures"]])
            _spoil_photo(Path(folder) / "spoiled", sets[name], other_photos, alone[name], rng, counts, kinds, failures)
    print(json.dumps({"seed": seed, **counts, "failures": failures, "kinds": kinds}, indent=1))


def _spoil_photo(
    folder: Path,
    good: dict[str, bytes],
    other_photos: list[bytes],
    alone: set[str],
    rng: np.random.Generator,
    counts: Counter[str],
    kinds: dict[str, Counter[str]],
    failures: list[str],
) -> None:
    """Count what became of one capture."""
    share = rng.uniform(0.03, 0.3)
    names = rng.choice([*SPOILED, *DAMAGED], max(1, round(share / (1 - share) * len(good))), replace=False)
    spoiled, damaged = {}, {}
    for kind in (str(name) for name in names):
        whole, foreign = good[str(rng.choice(list(good)))], other_photos[rng.integers(len(other_photos))]
        file = f"{kind}.jpg"
        if kind in SPOILED:
            spoiled[file] = SPOILED[kind](_pixels(whole), _pixels(foreign), rng)
        elif rng.random() < 0.5:
            spoiled[file] = DAMAGED[kind](whole)
        else:
            spoiled[file], damaged[file] = whole, DAMAGED[kind](whole)
    counts["captures"] += 1
    counts["good"] += len(alone)
    counts["spoiled"] += len(spoiled)
    where = f"capture {counts['captures'] - 1}, {', '.join(spoiled)}"
    try:
        capture = capture_of(folder, good | spoiled, damaged, SETTINGS)
    except FastSplatError as error:
        counts["failed"] += 1
        failures.append(f"{where}: {error}")
        return
    placed, report = _placed(capture), capture.report
    reasons: dict[str, str] = {
        verdict.name: verdict.not_placed for verdict in report.photos if verdict.not_placed and verdict.advice
    }
    reasons |= {Path(path).name: "left out" for path in report.left_out}
    for file in spoiled:
        kinds[Path(file).stem]["placed" if file in placed else reasons.get(file, "unnamed")] += 1
    lost, unnamed = alone - placed, spoiled.keys() - placed - reasons.keys()
    counts["good_lost"] += len(lost)
    counts["unnamed"] += len(unnamed)
    if lost or unnamed:
        why = ", ".join(f"{file} ({reasons.get(file)})" for file in sorted(lost))
        failures.append(f"{where}: lost {why or None}, unnamed {sorted(unnamed)}")


def _placed(capture: Capture) -> set[str]:
    return {view.posed.name for view in capture.views}


def _pixels(photo: bytes) -> np.ndarray[Any, Any]:
    return np.asarray(Image.open(io.BytesIO(photo)).convert("RGB"))


def _thinned(folder: Path) -> dict[str, bytes]:
    paths = sorted(folder.iterdir())
    rows = np.linspace(0, len(paths) - 1, min(_GOOD, len(paths))).round().astype(int)
    return {paths[row].name: paths[row].read_bytes() for row in rows}


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 15.0, int(sys.argv[2]) if len(sys.argv) > 2 else 0)
