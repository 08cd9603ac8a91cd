"""Masks people and other moving objects before anything else uses a photo.

The caller's `FindMovers` finds them. Under a promise of privacy they are replaced by gray in memory, before the photo
is measured, matched, trained on or written: photos that differ only there are the same from then on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.captures import CaptureReport, View, WithheldReport
from fastsplat.service.capture.formats.image_io import save_rgb
from fastsplat_contract.jobs.operations import Privacy

BLANK = 128  # stored value of a withheld pixel in all channels
_RIM = 0.015
"""Margin over the longer side: SSIM reads 5 pixels, features a few times their scale."""
_MIN_RIM_PX = 4

FindMovers = Callable[[NDArray[np.uint8]], NDArray[np.bool_]]
"""Masks pixels to withhold [H, W] in an upright RGB photo [H, W, 3]; deterministic."""


@dataclass(frozen=True)
class Withholding:
    """Rule for withholding; under `privacy`, withheld pixels are stored nowhere either."""

    find: FindMovers
    privacy: Privacy | None = None

    def apply(self, pixels: NDArray[np.uint8], movers: NDArray[np.bool_] | None = None) -> WithheldPhoto:
        """Masks a photo.

        Args:
            pixels: uint8 [H, W, 3], upright.
            movers: bool [H, W], pixels to withhold; None: found by `find`.
        """
        movers = self.find(pixels) if movers is None else movers
        assert movers.shape == pixels.shape[:2] and movers.dtype == np.bool_
        if not movers.any():
            return WithheldPhoto(pixels)
        if self.privacy:
            pixels = np.where(movers[..., None], np.uint8(BLANK), pixels)
        rim = max(_MIN_RIM_PX, round(_RIM * max(movers.shape)))
        return WithheldPhoto(pixels, ~dilated(movers, rim), float(movers.mean()))


@dataclass(frozen=True)
class WithheldPhoto:
    """A photo after `Withholding.apply`."""

    pixels: NDArray[np.uint8]  # [H, W, 3]
    usable: NDArray[np.bool_] | None = None  # [H, W]; None if all may be used
    share: float = 0.0  # of pixels withheld, 0..1, without the margin


class WithheldPixels:
    """Withholds pixels of a capture's photos and records their shares.

    Args:
        withholding: None: every photo stays unchanged.
        folder: for masks of photos whose features are extracted; made with the first.
    """

    def __init__(self, withholding: Withholding | None, folder: Path) -> None:
        self._withholding, self._folder = withholding, folder
        self._shares: dict[str, float] = {}

    @property
    def promised(self) -> bool:
        """Checks for a promise of privacy, under which withheld pixels influence nothing."""
        return self._withholding is not None and self._withholding.privacy is not None

    def movers(self, pixels: NDArray[np.uint8]) -> NDArray[np.bool_] | None:
        """Finds what `take` would withhold, bool [H, W]; None without withholding."""
        return None if self._withholding is None else self._withholding.find(pixels)

    def take(
        self, name: str, pixels: NDArray[np.uint8], file: str = "", movers: NDArray[np.bool_] | None = None
    ) -> WithheldPhoto:
        """Masks the photo `name`, by `movers` if known; its feature mask is stored as `file`."""
        if self._withholding is None:
            return WithheldPhoto(pixels)
        photo = self._withholding.apply(pixels, movers)
        self._shares[name] = photo.share
        if file and photo.usable is not None:
            self._save(photo.usable, file)
        return photo

    def take_frame(self, path: Path, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Masks a video's frame at `path`, rewriting it if pixels are blanked."""
        photo = self.take(path.name, pixels, path.name)
        if photo.pixels is not pixels:
            save_rgb(photo.pixels, path)
        return photo.pixels

    def split(self, name: str, views: Sequence[str]) -> None:
        """Replaces the photo `name` by its views, each with the photo's share."""
        if name in self._shares:
            share = self._shares.pop(name)
            self._shares.update(dict.fromkeys(views, share))

    def usable(self, file: str) -> NDArray[np.bool_] | None:
        """Loads `WithheldPhoto.usable` of the photo whose mask was stored for `file`."""
        path = self._mask(file)
        return _load(path) if path.is_file() else None

    def mask_features(self, views: Sequence[View]) -> None:
        """Stores the masks of written views as feature masks."""
        for view in views:
            if self._shares.get(view.posed.name) and view.valid_path is not None:
                self._save(_load(view.valid_path), view.image_path.name)

    @property
    def request(self) -> dict[str, str]:
        """Request entries for structure from motion: the mask folder, if there are masks."""
        return {"mask_folder": str(self._folder)} if self._folder.is_dir() else {}

    def reported(self, report: CaptureReport) -> CaptureReport:
        """Adds the withheld shares, per photo to 1/10,000 and in total; unchanged without withholding."""
        if self._withholding is None:
            return report
        shares = list(self._shares.values())
        mean = sum(shares) / len(shares) if shares else 0.0
        withheld = WithheldReport(self._withholding.privacy, sum(share > 0 for share in shares), mean)
        photos = tuple(replace(photo, withheld=round(self._shares.get(photo.name, 0.0), 4)) for photo in report.photos)
        return replace(report, photos=photos, withheld=withheld)

    def _mask(self, file: str) -> Path:
        return self._folder / f"{file}.png"  # as COLMAP looks for it

    def _save(self, usable: NDArray[np.bool_], file: str) -> None:
        path = self._mask(file)  # a face of a panorama lies in a folder of its own
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(usable.astype(np.uint8) * 255).save(path)


def both_masks(first: NDArray[np.bool_] | None, second: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """Intersects two masks [H, W]; None is true everywhere."""
    if first is None or second is None:
        return second if first is None else first
    return first & second


def dilated(mask: NDArray[np.bool_], pixels: int) -> NDArray[np.bool_]:
    """Dilates a mask [H, W] by a disc of so many pixels."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * pixels + 1, 2 * pixels + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disc) > 0)


def _load(path: Path) -> NDArray[np.bool_]:
    with Image.open(path) as image:
        return np.asarray(image) > 0
