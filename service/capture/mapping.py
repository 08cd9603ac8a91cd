"""COLMAP's mappers, and what is tried when the first one leaves photos without a place or contradicts their matches.

The first mapping has COLMAP's own thresholds. Only where it is poor is there more, always in this order:

1. pairs whose matches contradict those of other pairs are taken out (`match_cycles`), where the model contradicts many;
2. lower thresholds, which cost one more mapping at most, as features and matches are there;
3. guided matching (COLMAP's) of the pairs that join photos without a place to others, then as before;
4. those that are left once more, with the matches that the next paragraph is about.

Each is judged by matches that it was not given (`model_agreement.choose_held_out`), which the first mapping had:
so what comes later is not favored.
"""

from __future__ import annotations

import shutil
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pycolmap

from fastsplat.service.capture import geometry, mapping_snapshots, match_cycles, rigs
from fastsplat.service.capture.model_agreement import (
    PairMatches,
    choose_held_out,
    contradictions,
    explained,
    give_back,
    verified_matches,
    withhold,
)

Report = Callable[[float, str], None]
Models = list[pycolmap.Reconstruction]
"""All disconnected models, largest first."""
Rematch = Callable[[Path, Sequence[tuple[int, int]]], None]
"""Matches pairs of images of a database anew, guided by the geometry that they have."""

SEED = 0
_MOST_MODELS = 10
_FEWEST_INLIERS = 15
_FEWEST_MATCHES = 10
_FEWEST_INITIAL_INLIERS = 50
_GUIDED_PAIRS_PER_IMAGE = 3
_MOST_GUIDED_PAIRS = 48
"""One takes ten times as long as an ordinary pair."""
_FEW_PLACED = 0.8
_AS_GOOD = 0.98
"""Held-out matches that a model explains may be fewer by this factor where it places more photos."""
_GLOBAL_PLACED = 0.95
_FEWEST_TO_HOLD_OUT = 60
"""Matches of a pair that can do without a tenth of them."""
_FEWEST_OF_REPEATS = 30


def mapper_options(*, lower: bool = False) -> pycolmap.IncrementalPipelineOptions:
    """Repeatable options; `lower` asks for fewer matches to begin with, of a pair, and of an image with the points."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = SEED
    options.min_model_size = 2
    options.max_num_models = _MOST_MODELS
    if lower:
        options.min_num_matches = _FEWEST_MATCHES
        options.mapper.abs_pose_min_num_inliers = _FEWEST_INLIERS
        options.mapper.init_min_num_inliers = _FEWEST_INITIAL_INLIERS
    return options


@dataclass(frozen=True)
class Mapping:
    """One capture that is mapped.

    Attributes:
        database: features and verified matches of its images.
        images: folder of the images.
        folder: where models and copies of the database go.
        entries: the images, as `sfm.reconstruct` takes them.
        rematch: see `Rematch`.
        report: receives a message and the share of the mapping that is done.
    """

    database: Path
    images: Path
    folder: Path
    entries: Sequence[dict[str, Any]]
    rematch: Rematch
    report: Report

    @property
    def count(self) -> int:
        """Of images."""
        return len(self.entries)

    def run(self, global_images: int) -> Models:
        """The best models that were reached; by the global mapper first where there are more than `global_images`,
        and none of them the faces of panoramas."""
        models: Models = []
        if self.count > global_images and not rigs.has_rigs(self.entries):
            self.report(0.0, f"registering {self.count} images at once")
            models = self._globally()
            if self._is_fine(models, _GLOBAL_PLACED):
                return models
        incremental = self._first()
        models = self._better(models, incremental, verified_matches(self.database))
        return models if self._is_fine(models, 1.0) else self._again(models)

    def _is_fine(self, models: Models, share: float) -> bool:
        if not models or models[0].num_reg_images() < share * self.count:
            return False
        return not geometry.repetition_warning(*contradictions(models[0], self.database))

    def _first(self) -> Models:
        registered = 2

        def report_next_image() -> None:
            nonlocal registered
            registered += 1
            mapping_snapshots.keep_newest(snapshots, self.folder, pycolmap.Reconstruction)
            done = min(registered, self.count)
            self.report(done / self.count, f"registering images {done}/{self.count}")

        snapshots = self.folder / "snapshots"
        snapshots.mkdir()
        options = mapper_options()
        options.snapshot_path = snapshots
        options.snapshot_frames_freq = mapping_snapshots.frames_between(self.count)
        return self._map(self.database, "models", options, report_next_image)

    def _globally(self) -> Models:
        """By rotation averaging and global positioning (Pan et al., "Global structure-from-motion revisited", ECCV
        2024), whose time grows with the matches and not with the square of the images."""
        options = pycolmap.GlobalPipelineOptions()
        options.num_threads = options.mapper.num_threads = 1
        options.random_seed = options.mapper.random_seed = SEED
        options.min_model_size = 2
        output = self.folder / "global"
        output.mkdir()
        return _largest_first(pycolmap.global_mapping(self.database, self.images, output, options=options))

    def _again(self, models: Models) -> Models:
        copy = self.folder / "again.db"
        shutil.copyfile(self.database, copy)
        if models and geometry.repetition_warning(*contradictions(models[0], self.database)):
            models = self._consistent(models, copy)
        held_out = choose_held_out(verified_matches(copy), _FEWEST_TO_HOLD_OUT)
        withhold(copy, held_out)
        for name, guided in (("lower", False), ("guided", True), ("complete", False)):
            left = self._left_out(models)
            if not left:
                break
            self.report(1.0, f"registering {len(left)} images that have no place yet")
            if guided:
                self.rematch(copy, _strongest_pairs(copy, left))
                withhold(copy, held_out)
            if name == "complete":
                give_back(copy, held_out)
            few = len(left) > (1 - _FEW_PLACED) * self.count and name != "complete"
            start = None if few or not models else models[0]
            again = self._map(copy, name, mapper_options(lower=True), start=start)
            models = self._better(models, again, held_out)
        return models

    def _consistent(self, models: Models, copy: Path) -> Models:
        """The better of `models` and those without contradicting pairs, which in the latter case leave the copy too."""
        self.report(1.0, "registering images without contradicting pairs")
        if not _drop_contradicting(copy):
            return models
        trial = self.folder / "consistent.db"
        shutil.copyfile(copy, trial)
        # Right pairs may have few matches beside wrong ones that look the same: all of them have a say.
        held_out = choose_held_out(verified_matches(self.database), _FEWEST_OF_REPEATS)
        withhold(trial, held_out)
        better = self._better(models, self._map(trial, "consistent", mapper_options()), held_out)
        if better is models:
            shutil.copyfile(self.database, copy)
        return better

    def _map(
        self,
        database: Path,
        name: str,
        options: pycolmap.IncrementalPipelineOptions,
        on_image: Callable[[], None] = lambda: None,
        start: pycolmap.Reconstruction | None = None,
    ) -> Models:
        """Models from nothing, or `start` with more images."""
        output = self.folder / name
        output.mkdir()
        rigs.hold_rigs(options, database, self.entries)
        before = ""
        if start is not None:
            (output / "start").mkdir()
            start.write(output / "start")
            before = str(output / "start")
        return _largest_first(
            pycolmap.incremental_mapping(
                database, self.images, output, options=options, input_path=before, next_image_callback=on_image
            )
        )

    def _better(self, models: Models, later: Models, held_out: PairMatches) -> Models:
        """`later` if it places more images and explains no fewer matches, or explains more; else `models`."""
        if not models or not later:
            return models or later
        placed, placed_later = models[0].num_reg_images(), later[0].num_reg_images()
        matches, matches_later = (explained(some[0], self.database, held_out) for some in (models, later))
        if placed_later > placed:
            return later if matches_later >= _AS_GOOD * matches else models
        return later if matches_later * _AS_GOOD > matches else models

    def _left_out(self, models: Models) -> set[int]:
        """Ids of the images without a place."""
        placed = {image.image_id for image in models[0].images.values() if image.has_pose} if models else set()
        with pycolmap.Database.open(self.database) as reader:
            return {image.image_id for image in reader.read_all_images()} - placed


def _largest_first(models: dict[int, pycolmap.Reconstruction]) -> Models:
    return sorted(models.values(), key=lambda model: (-model.num_reg_images(), -model.num_points3D()))


def _strongest_pairs(database: Path, images: set[int]) -> list[tuple[int, int]]:
    """The few verified pairs with most matches of each of these images, sorted."""
    of_image = defaultdict(list)
    for pair, rows in verified_matches(database).items():
        for image_id in set(pair) & images:
            of_image[image_id].append((-len(rows), pair))
    strongest = {row for rows in of_image.values() for row in sorted(rows)[:_GUIDED_PAIRS_PER_IMAGE]}
    return sorted(pair for _, pair in sorted(strongest)[:_MOST_GUIDED_PAIRS])


def _drop_contradicting(database: Path) -> int:
    """Take pairs that contradict others out of a database; how many."""
    with pycolmap.Database.open(database) as editor:
        matches = verified_matches(database)
        pixels = {
            image: editor.read_keypoints(image) for image in sorted({image for pair in matches for image in pair})
        }
        wrong = match_cycles.contradicting_pairs(matches, {image: rows[:, :2] for image, rows in pixels.items()})
        for pair in wrong:
            editor.delete_two_view_geometry(*pair)
    return len(wrong)
