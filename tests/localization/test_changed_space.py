"""Laws of pieces of space that photos agree on, of cubes before an empty wall that drawn masks show."""

from __future__ import annotations

import numpy as np
import pytest

from fastsplat.service.localization.changes import ChangedPiece, changed_pieces
from fastsplat.service.localization.photometric_refinement import Comparison
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import look_at

_CAMERA = Camera(160, 120, 150.0, 150.0, 80.0, 60.0)
_PLACE = np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]])
_AT = np.array([0.11, -0.07, 0.05])


def _pieces(side: float, *, shown_by: int) -> tuple[ChangedPiece, ...]:
    """Of six photos around, three units away, before whose surfaces the first so many show a ball as something new."""
    comparisons, differing = [], []
    x, y = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    for row, angle in enumerate(np.linspace(0, 1.5 * np.pi, 6)):
        pose = look_at((3 * np.cos(angle), 3 * np.sin(angle), 0.8), (0, 0, 0))
        posed = PosedCamera(_CAMERA, pose)
        depth, blank = np.full((120, 160), 9.0, np.float32), np.zeros((120, 160, 3), np.float32)
        known = np.ones((120, 160), np.bool_)
        comparisons.append(Comparison(posed, blank, blank, depth, known, known, 0.0))
        middle = posed.camera_from_world() @ [*_AT, 1]
        u, v = (150 * middle[:2] / middle[2]) + (80, 60)
        ball = (x - u) ** 2 + (y - v) ** 2 <= (150 * side / 2 / middle[2]) ** 2
        differing.append((ball if row < shown_by else ~known, ~known))
    return changed_pieces(comparisons, differing, _PLACE)


def test_what_all_photos_show_is_one_piece_about_its_middle() -> None:
    (piece,) = _pieces(0.3, shown_by=6)
    assert piece.views == (0, 1, 2, 3, 4, 5) and piece.share > 0.9
    assert piece.box.mean(axis=0) == pytest.approx(_AT, abs=0.02)
    assert piece.box[1] - piece.box[0] == pytest.approx(0.3, abs=0.1)


@pytest.mark.parametrize(("pixels", "found"), [(6, False), (14, False), (28, False), (60, True), (100, True)])
def test_of_fewer_than_thirty_pixels_a_photo_nothing_is_told(pixels: int, found: bool) -> None:
    side = 2 * np.sqrt(pixels / np.pi) * 3.1 / 150
    assert bool(_pieces(side, shown_by=6)) == found


def test_what_half_of_the_photos_do_not_show_is_nothing() -> None:
    assert _pieces(0.3, shown_by=3) == ()
