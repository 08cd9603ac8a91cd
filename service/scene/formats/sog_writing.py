"""Writes Gaussians as PlayCanvas' SOG, version 2: lossless WebP images in a zip.

Each image has a pixel per Gaussian; `meta.json` describes the bytes. Files are 1/20 to 1/15 of the PLY. Follows the
published specification, and where that is open its reference program (`@playcanvas/splat-transform`): axes as in 3DGS
files, quaternions as w x y z, scales as logarithms.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.sparse import csr_array

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.scene.artefact.scene import F32, Gaussians
from fastsplat.service.scene.formats.zips import zipped
from fastsplat.service.scene.gaussians.morton import morton_order
from fastsplat_contract.errors import LimitExceededError

MOST_GAUSSIANS = 16_380**2
"""WebP allows 16,383 pixels a side; sides here are multiples of 4."""

_LEAST_ENTRIES, _MOST_ENTRIES = 1 << 10, 1 << 16
_GAUSSIANS_PER_ENTRY = 8
"""Gaussians per palette entry of higher harmonics.

On the sample (39,389 Gaussians, degree 1) files have 597 KB with 16, 620 KB with 8, 663 KB with 4 and 820 KB with 1;
renderings are 49.7, 50.4, 51.1 and 52.1 dB PSNR from the scene's own.
"""

_ENTRIES_A_ROW = 64
_STEPS = 65_535
_EFFORT = 50  # encoder effort, 0 to 100

U8 = NDArray[np.uint8]

_CODES = 256
"""Entries of a codebook."""

_BINS = 4096
_ROUNDS = 8
_SAMPLES_PER_ENTRY = 64  # rows per coarse cluster; more do not improve them

_DISTANCES = 1 << 22  # held in memory at once, float32


def sog_bytes(gaussians: Gaussians) -> bytes:
    """Encodes Gaussians in Morton order of their means, deterministically and without codes.

    Maximum errors: means half of 1/65,535 of the range of sign(x)·ln(1 + |x|) along each axis; opacities 1/510; log
    scales and constant coefficients 1/256 of their overall range; the three smaller components of unit quaternions
    1/360. Higher coefficients of up to 1,024 Gaussians 1/256 of their range; of more, `palette` replaces similar rows
    by their mean, which is within that.

    Raises:
        LimitExceededError: more than `MOST_GAUSSIANS`.
        CancelledError: the call was cancelled.
    """
    count = len(gaussians)
    if count > MOST_GAUSSIANS:
        raise LimitExceededError(
            f"a SOG file of {count} Gaussians",
            field="format",
            limit=f"{MOST_GAUSSIANS} Gaussians",
            hint="Export it as ply or spz, or some of its objects alone.",
        )
    order = morton_order(gaussians.means)
    files: dict[str, bytes] = {}
    meta: dict[str, Any] = {"version": 2, "asset": {"generator": "FAST-Splat"}, "count": count, "antialias": False}

    def add(name: str, pictures: Mapping[str, U8], **more: Any) -> None:
        files.update({f"{key}.webp": _webp(picture) for key, picture in pictures.items()})
        meta[name] = more | {"files": [f"{key}.webp" for key in pictures]}

    low, high, steps = _positions(gaussians.means[order])
    halves = {"means_l": _picture(steps & 0xFF), "means_u": _picture(steps >> 8)}
    add("means", halves, mins=low, maxs=high)
    entries, indices = codebook(gaussians.log_scales[order])
    add("scales", {"scales": _picture(indices)}, codebook=_numbers(entries))
    add("quats", {"quats": _picture(_smallest_three(gaussians.quats[order]))})
    entries, indices = codebook(gaussians.sh[order, 0])
    opacities = np.rint(255 / (1 + np.exp(-gaussians.logit_opacities[order, None].astype(np.float64))))
    add("sh0", {"sh0": _picture(np.concatenate([indices, opacities], axis=1))}, codebook=_numbers(entries))
    if gaussians.sh_degree and count:
        bands = gaussians.sh[order, 1:]
        rows, labels = palette(bands.reshape(count, -1), palette_entries(count))
        entries, indices = codebook(rows)
        pictures = {
            "shN_centroids": _centroids(indices.reshape(len(rows), -1, 3)),
            "shN_labels": _picture(np.stack([labels & 0xFF, labels >> 8, np.zeros_like(labels)], axis=1)),
        }
        add("shN", pictures, count=len(rows), bands=gaussians.sh_degree, codebook=_numbers(entries))
    files["meta.json"] = json.dumps(meta, separators=(",", ":")).encode()
    return zipped(files, compressed=False)


def palette_entries(count: int) -> int:
    """Returns the maximum number of palette rows for `count` Gaussians."""
    return min(max(count // _GAUSSIANS_PER_ENTRY, _LEAST_ENTRIES), _MOST_ENTRIES)


def _positions(means: F32) -> tuple[list[float], list[float], NDArray[np.intp]]:
    """Returns minimum and maximum log position per axis, and steps [G, 3] of 1/65,535 between."""
    logs = np.sign(means) * np.log1p(np.abs(means.astype(np.float64)))
    if not len(logs):
        return [0.0] * 3, [0.0] * 3, np.zeros((0, 3), np.intp)
    low, high = logs.min(axis=0), logs.max(axis=0)
    steps = np.rint((logs - low) / np.where(high > low, high - low, 1) * _STEPS).astype(np.intp)
    return low.tolist(), high.tolist(), steps


def _smallest_three(quats: F32) -> NDArray[np.floating]:
    """Encodes quaternions [G, 4] as the three smaller components and the largest's index.

    Values are 0..255: the smaller components in the order w x y z, then 252 + the index of the largest, made positive.
    """
    wxyz = quats.astype(np.float64)
    wxyz /= np.maximum(np.linalg.norm(wxyz, axis=1, keepdims=True), 1e-30)
    largest = np.abs(wxyz).argmax(axis=1)[:, None]
    wxyz *= np.where(np.take_along_axis(wxyz, largest, axis=1) < 0, -1.0, 1.0)
    places = np.arange(3) + (largest <= np.arange(3))
    smaller = np.take_along_axis(wxyz, places, axis=1)
    return np.concatenate([np.rint((smaller * math.sqrt(0.5) + 0.5) * 255).clip(0, 255), 252 + largest], axis=1)


def _picture(pixels: NDArray[np.integer] | NDArray[np.floating]) -> U8:
    """Arranges pixels [G, C] as a nearly square image with sides multiples of 4."""
    count, channels = pixels.shape
    width = 4 * max(1, math.ceil(math.sqrt(count) / 4))
    height = 4 * max(1, math.ceil(count / width / 4))
    picture = np.zeros((height * width, channels), np.uint8)
    picture[:count] = pixels
    return picture.reshape(height, width, channels)


def _centroids(entries: U8) -> U8:
    """Arranges entries [P, K, 3] as image rows of 64 entries, K pixels each."""
    count, pixels, _ = entries.shape
    height = math.ceil(count / _ENTRIES_A_ROW)
    picture = np.zeros((height * _ENTRIES_A_ROW, pixels, 3), np.uint8)
    picture[:count] = entries
    return picture.reshape(height, _ENTRIES_A_ROW * pixels, 3)


def _webp(picture: U8) -> bytes:
    check_cancelled()
    file = BytesIO()
    # exact: keeps the colors of pixels whose alpha is 0
    Image.fromarray(picture).save(file, "WEBP", lossless=True, exact=True, quality=_EFFORT)
    return file.getvalue()


def _numbers(values: F32) -> list[float]:
    """Converts to the shortest decimals that round-trip in single precision."""
    return [float(str(value)) for value in values]


def codebook(values: F32) -> tuple[F32, NDArray[np.uint8]]:
    """Quantizes values to 256 ascending entries, float32, and uint8 indices.

    Entries are quantiles of a mixture: half the cube root of the density, which minimizes squared error (Panter and
    Dite 1951), half uniform, which keeps every value within 1/256 of the range from its entry.
    """
    if not values.size:
        return np.zeros(_CODES, np.float32), np.zeros(values.shape, np.uint8)
    low, high = float(values.min()), float(values.max())
    counts, edges = np.histogram(values.astype(np.float64), _BINS, (low, high) if high > low else (low - 1, low + 1))
    if high == low:
        edges[:] = low
    density = np.cbrt(counts)
    shares = np.cumsum(density / density.sum() + 1 / _BINS) / 2
    entries = np.interp((np.arange(_CODES) + 0.5) / _CODES, np.concatenate([[0.0], shares]), edges).astype(np.float32)
    middles = (entries[1:].astype(np.float64) + entries[:-1]) / 2
    return entries, np.searchsorted(middles, values).astype(np.uint8)


def palette(rows: F32, size: int) -> tuple[F32, NDArray[np.intp]]:
    """Quantizes rows [G, C] to at most `size` entries, float32 [P, C], and indices [G].

    Two-level k-means (Lloyd 1982): coarse clusters, then each on its own, so a million rows and 65,536 entries cost no
    more than 512 clusters of them. Deterministic. Few rows are their own entries.

    Raises:
        CancelledError: the call was cancelled.
    """
    if len(rows) <= size:
        return rows, np.arange(len(rows))
    rng = np.random.default_rng(0)
    coarse = max(1, math.isqrt(size))
    sample = rows[rng.choice(len(rows), min(len(rows), _SAMPLES_PER_ENTRY * coarse), replace=False)]
    cluster = _nearest(rows, _clustered(sample, coarse, rng))
    order = np.argsort(cluster, kind="stable")
    counts = np.bincount(cluster, minlength=coarse)
    ends = np.cumsum(counts)
    entries: list[F32] = []
    labels = np.empty(len(rows), np.intp)
    used = 0
    for count, end in zip(counts.tolist(), ends.tolist(), strict=True):
        members = order[end - count : end]
        if not count:
            continue
        # Shares are rounded down, so that at least one each stays within `size` in total.
        share = max(1, count * (size - coarse) // len(rows))
        centers = _clustered(rows[members], share, rng)
        labels[members] = used + _nearest(rows[members], centers)
        entries.append(centers)
        used += len(centers)
    return np.concatenate(entries), labels


def _clustered(rows: F32, count: int, rng: np.random.Generator) -> F32:
    """K-means centers, float32 [count, C]; empty clusters keep their initial centers."""
    centers = rows[rng.choice(len(rows), min(count, len(rows)), replace=False)]
    for _ in range(_ROUNDS):
        nearest = _nearest(rows, centers)
        members = csr_array(
            (np.ones(len(rows), np.float32), nearest, np.arange(len(rows) + 1)), (len(rows), len(centers))
        )
        counts = np.bincount(nearest, minlength=len(centers))[:, None]
        centers = np.where(counts > 0, members.T @ rows / np.maximum(counts, 1), centers).astype(np.float32)
    return centers


def _nearest(rows: F32, centers: F32) -> NDArray[np.intp]:
    from scipy.cluster.vq import vq  # compressed files alone need it

    nearest = np.empty(len(rows), np.intp)
    step = max(1, _DISTANCES // len(centers))
    for start in range(0, len(rows), step):
        check_cancelled()
        nearest[start : start + step] = vq(rows[start : start + step], centers, check_finite=False)[0]
    return nearest
