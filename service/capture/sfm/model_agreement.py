"""Measures the agreement of poses with verified matches, including held-out ones."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.capture.sfm import geometry

PairMatches = Mapping[tuple[int, int], NDArray[np.uint32]]
"""Feature rows [M, 2] by the ids of two images."""

_HELD_OUT_EVERY = 10
_EXPLAINED_PX = 4.0  # epipolar distance that COLMAP allows for verified matches


class VerifiedMatches:
    """Verified matches of a database and their pixels, read once; later writes are not noticed."""

    def __init__(self, database: Path) -> None:
        self.pairs = verified_matches(database)
        """By pair, in the order of the ids."""
        with pycolmap.Database.open(database) as reader:
            self.pixels: dict[int, NDArray[np.float32]] = {
                image: np.array(reader.read_keypoints(image)[:, :2], np.float32)
                for image in sorted({image for pair in self.pairs for image in pair})
            }
            """Pixels of features by image, [F, 2]."""

    def contradictions(self, model: pycolmap.Reconstruction) -> tuple[int, int]:
        """Counts `geometry.contradictions` of a model, including pairs with one unregistered image."""
        placed = _placed(model)
        some = {pair: rows for pair, rows in self.pairs.items() if placed & set(pair)}
        errors = self._errors(model, some)
        medians = [float("inf") if pair not in errors else float(np.nanmedian(errors[pair])) for pair in some]
        return geometry.contradictions([len(rows) for rows in some.values()], medians)

    def explained(self, model: pycolmap.Reconstruction, matches: PairMatches) -> int:
        """Counts matches of placed images within 4 px of a model's epipolar lines."""
        return sum(int((values <= _EXPLAINED_PX).sum()) for values in self._errors(model, matches).values())

    def _errors(
        self, model: pycolmap.Reconstruction, matches: PairMatches
    ) -> dict[tuple[int, int], NDArray[np.float64]]:
        """Epipolar errors in pixels, [M], of pairs with two posed images."""
        placed = _placed(model)
        rays: dict[int, NDArray[np.float64]] = {}
        errors = {}
        for pair, rows in matches.items():
            if not placed >= set(pair):
                continue
            first, second = (model.images[image_id] for image_id in pair)
            for image in (first, second):
                if image.image_id not in rays:
                    pixels = self.pixels[image.image_id].astype(np.float64)
                    rays[image.image_id] = np.asarray(model.cameras[image.camera_id].cam_from_img(pixels))
            relative = second.cam_from_world() * first.cam_from_world().inverse()
            pose = np.eye(4)
            pose[:3] = relative.matrix()
            rays1, rays2 = rays[pair[0]][rows[:, 0]], rays[pair[1]][rows[:, 1]]
            errors[pair] = geometry.epipolar_error_px(
                rays1, rays2, pose, model.cameras[first.camera_id].mean_focal_length()
            )
        return errors


def verified_matches(database: Path) -> dict[tuple[int, int], NDArray[np.uint32]]:
    """Reads non-empty verified matches of pairs (i, j), i < j, ordered by ids."""
    with pycolmap.Database.open(database) as reader:
        pair_ids, pairs = reader.read_two_view_geometries()
    rows = sorted(zip(pair_ids, pairs, strict=True), key=lambda row: row[0])
    return {
        pycolmap.pair_id_to_image_pair(pair_id): np.asarray(pair.inlier_matches)
        for pair_id, pair in rows
        if len(pair.inlier_matches)
    }


def choose_held_out(matches: PairMatches, fewest: int) -> dict[tuple[int, int], NDArray[np.uint32]]:
    """Chooses every tenth match of pairs with at least `fewest`, to judge models by."""
    return {pair: rows[::_HELD_OUT_EVERY] for pair, rows in matches.items() if len(rows) >= fewest}


def withhold(database: Path, held_out: PairMatches) -> None:
    """Removes matches from a database's verified ones."""
    with pycolmap.Database.open(database) as editor:
        for pair, withheld in held_out.items():
            if not editor.exists_two_view_geometry(*pair):
                continue
            pair_geometry = editor.read_two_view_geometry(*pair)
            rows = np.asarray(pair_geometry.inlier_matches)
            pair_geometry.inlier_matches = rows[~np.isin(_keys(rows), _keys(withheld))]
            editor.update_two_view_geometry(*pair, pair_geometry)


def give_back(database: Path, held_out: PairMatches) -> None:
    """Undoes `withhold` for the pairs that are still in the database."""
    with pycolmap.Database.open(database) as editor:
        for pair, withheld in held_out.items():
            if editor.exists_two_view_geometry(*pair):
                pair_geometry = editor.read_two_view_geometry(*pair)
                rows = np.concatenate([np.asarray(pair_geometry.inlier_matches), withheld])
                pair_geometry.inlier_matches = np.unique(rows, axis=0)
                editor.update_two_view_geometry(*pair, pair_geometry)


def _keys(rows: NDArray[np.uint32]) -> NDArray[np.uint64]:
    """Packs each match into one number, [M]."""
    return np.asarray(rows[:, 0].astype(np.uint64) << np.uint64(32) | rows[:, 1].astype(np.uint64))


def _placed(model: pycolmap.Reconstruction) -> set[int]:
    return {image.image_id for image in model.images.values() if image.has_pose}
