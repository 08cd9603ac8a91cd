"""Runs COLMAP's mappers and retries if photos stay unplaced or matches are contradicted.

The first mapping has COLMAP's own thresholds. Only if it is poor, these follow in order:

1. pairs that contradict other pairs are removed (`contradicting_pairs`), if the model contradicts many;
2. lower thresholds, at the cost of one more mapping, as features and matches are reused;
3. guided matching (COLMAP's) of the pairs that join unplaced photos to others, then as before;
4. the unplaced ones once more, with the held-out matches.

Each is judged by held-out matches (`model_agreement.choose_held_out`). The first mapping had them, so later ones are
not favored.

Images whose cameras diverged are removed: one that shares its camera with no other constrains its lens little.

With repeated structures, a pair may agree on the wrong copy with a small residual. Cycles reveal it (Zach, Klopschitz
and Pollefeys, CVPR 2010). Matches are composed, not rotations, as a wall's pattern may shift by a tile without one.
"""

from __future__ import annotations

import shutil
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Sequence
from collections.abc import Mapping as Lookup
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.capture.photos.camera_model import CameraModel, check_camera_model
from fastsplat.service.capture.photos.lens_faces import lens_of
from fastsplat.service.capture.sfm import geometry, mapping_snapshots, rigs
from fastsplat.service.capture.sfm.model_agreement import (
    PairMatches,
    VerifiedMatches,
    choose_held_out,
    give_back,
    withhold,
)
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.photos.photo_verdicts import NotPlaced

Report = Callable[[float, str], None]
Models = list[pycolmap.Reconstruction]
"""All disconnected models, largest first."""
Rematch = Callable[[Path, Sequence[tuple[int, int]]], None]
"""Matches image pairs of a database again, guided by their geometry."""

SEED = 0
_MOST_MODELS = 10
_FEWEST_INLIERS = 15
_FEWEST_MATCHES = 10
_FEWEST_INITIAL_INLIERS = 50
_GUIDED_PAIRS_PER_IMAGE = 3
_MOST_GUIDED_PAIRS = 48  # one takes ten times as long as an ordinary pair
_FEW_PLACED = 0.8
_AS_GOOD = 0.98
"""Share of explained held-out matches that suffices if more photos are placed."""
_GLOBAL_PLACED = 0.95
_FEWEST_TO_HOLD_OUT = 60  # matches of a pair that can spare a tenth
_FEWEST_OF_REPEATS = 30
_GROWTH, _MOST_ROUNDS = 1.3, 2
"""Growth of images or points that triggers bundle adjustment, and its most rounds."""
_FIRST_DONE, _CONSISTENT_DONE = 0.5, 0.6
"""Shares of the progress; most captures need only the first mapping."""

_FOCAL_RANGE = (0.25, 8.0)  # over the longer side: 127° to 7° of view

_Pairs = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]

_SAME_PX = 6.0
_FEWEST = 8  # matches around a cycle that make it count


def mapper_options(*, lower: bool = False) -> pycolmap.IncrementalPipelineOptions:
    """Makes repeatable options; `lower` lowers the thresholds for the first pair, pairs and images."""
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
class Mapped:
    """Result of a mapping."""

    models: Models
    verified: VerifiedMatches

    @cached_property
    def contradictions(self) -> tuple[int, int]:
        """`VerifiedMatches.contradictions` of the largest model; (0, 0) without models."""
        return self.verified.contradictions(self.models[0]) if self.models else (0, 0)

    @property
    def placed(self) -> int:
        """Number of images in the largest model."""
        return self.models[0].num_reg_images() if self.models else 0

    @property
    def repeats(self) -> bool:
        """Checks if the largest model is contradicted as often as with repeated structures."""
        return bool(geometry.repetition_warning(*self.contradictions))


@dataclass(frozen=True)
class Mapping:
    """A capture to be mapped."""

    database: Path  # features and verified matches
    images: Path
    folder: Path  # for models and copies of the database
    entries: Sequence[dict[str, Any]]  # images as in `sfm.reconstruct`
    rematch: Rematch
    report: Report  # receives the share of the mapping that is done, and a message

    @property
    def count(self) -> int:
        """Number of images."""
        return len(self.entries)

    @cached_property
    def _verified(self) -> VerifiedMatches:
        return VerifiedMatches(self.database)

    def without(self, files: Collection[str]) -> Mapping:
        """Copies the mapping to its own folder without some images and their matches."""
        folder = self.folder / "without"
        folder.mkdir()
        database = folder / "features.db"
        shutil.copyfile(self.database, database)
        with pycolmap.Database.open(database) as editor:
            ids = {image.image_id for image in editor.read_all_images() if image.name in files}
            for pair in self._verified.pairs:
                if ids & set(pair):
                    editor.delete_two_view_geometry(*pair)
        entries = [entry for entry in self.entries if entry["file"] not in files]
        return replace(self, database=database, folder=folder, entries=entries)

    def run(self, global_images: int) -> Mapped:
        """Maps the images; globally first for more than `global_images` without panorama faces."""
        best = Mapped([], self._verified)
        if self.count > global_images and not rigs.has_rigs(self.entries):
            self.report(0.0, f"registering {self.count} images at once")
            best = self._globally()
            if self._is_fine(best, _GLOBAL_PLACED):
                return best
        best = self._better(best, self._first(), self._verified.pairs)
        return best if self._is_fine(best, 1.0) else self._again(best)

    def _is_fine(self, mapped: Mapped, share: float) -> bool:
        return mapped.placed > 0 and mapped.placed >= share * self.count and not mapped.repeats

    def _first(self) -> Mapped:
        registered = 2

        def report_next_image() -> None:
            nonlocal registered
            registered += 1
            mapping_snapshots.keep_newest(snapshots, self.folder, pycolmap.Reconstruction)
            done = min(registered, self.count)
            self.report(_FIRST_DONE * done / self.count, f"registering images {done}/{self.count}")

        snapshots = self.folder / "snapshots"
        snapshots.mkdir()
        options = mapper_options()
        options.snapshot_path = snapshots
        options.snapshot_frames_freq = mapping_snapshots.frames_between(self.count)
        return self._map(self.database, "models", options, report_next_image)

    def _globally(self) -> Mapped:
        """Maps by rotation averaging and global positioning, in time linear in the matches.

        Pan et al., "Global structure-from-motion revisited", ECCV 2024.
        """
        options = pycolmap.GlobalPipelineOptions()
        options.num_threads = options.mapper.num_threads = 1
        options.random_seed = options.mapper.random_seed = SEED
        options.min_model_size = 2
        output = self.folder / "global"
        output.mkdir()
        return self._largest_first(pycolmap.global_mapping(self.database, self.images, output, options=options))

    def _again(self, best: Mapped) -> Mapped:
        pairs, wrong = self._verified.pairs, set[tuple[int, int]]()
        if best.repeats:
            best, wrong = self._consistent(best)
        if not self._left_out(best):
            return best
        copy = self._copy("again", wrong)
        pairs = {pair: rows for pair, rows in pairs.items() if pair not in wrong}
        held_out = choose_held_out(pairs, _FEWEST_TO_HOLD_OUT)
        withhold(copy, held_out)
        tries = (("lower", False), ("guided", True), ("complete", False))
        for number, (name, guided) in enumerate(tries):
            left = self._left_out(best)
            if not left:
                break
            begin, end = (
                _CONSISTENT_DONE + (1 - _CONSISTENT_DONE) * part / len(tries) for part in (number, number + 1)
            )
            message = f"registering {len(left)} images that have no place yet, try {number + 1} of {len(tries)}"
            self.report(begin, message)
            if guided:
                self.rematch(copy, strongest_pairs(pairs, held_out, left))
                withhold(copy, held_out)
            if name == "complete":
                give_back(copy, held_out)
            few = len(left) > (1 - _FEW_PLACED) * self.count and name != "complete"
            start = None if few or not best.models else best.models[0]
            on_image = self._counter(0 if start is None else start.num_reg_images(), begin, end, message)
            again = self._map(copy, name, mapper_options(lower=True), on_image, start)
            best = self._better(best, again, held_out)
        return best

    def _consistent(self, best: Mapped) -> tuple[Mapped, set[tuple[int, int]]]:
        """Maps without contradicting pairs; returns the better result and its removed pairs."""
        message = "registering images without contradicting pairs"
        self.report(_FIRST_DONE, message)
        wrong = set(contradicting_pairs(self._verified.pairs, self._verified.pixels))
        if not wrong:
            return best, wrong
        trial = self._copy("consistent", wrong)
        # Right pairs may have few matches beside wrong ones of the same look: even they are held out.
        held_out = choose_held_out(self._verified.pairs, _FEWEST_OF_REPEATS)
        withhold(trial, held_out)
        on_image = self._counter(0, _FIRST_DONE, _CONSISTENT_DONE, message)
        better = self._better(best, self._map(trial, "consistent", mapper_options(), on_image), held_out)
        return (best, set()) if better is best else (better, wrong)

    def _counter(self, placed: int, begin: float, end: float, message: str) -> Callable[[], None]:
        """Makes a callback that reports progress per image, starting from `placed` images."""

        def count() -> None:
            nonlocal placed
            placed = min(placed + 1, self.count)
            self.report(begin + (end - begin) * placed / self.count, message)

        return count

    def _copy(self, name: str, without: Collection[tuple[int, int]]) -> Path:
        """Copies the database without the verification of some pairs."""
        copy = self.folder / f"{name}.db"
        shutil.copyfile(self.database, copy)
        with pycolmap.Database.open(copy) as editor:
            for pair in without:
                editor.delete_two_view_geometry(*pair)
        return copy

    def _map(
        self,
        database: Path,
        name: str,
        options: pycolmap.IncrementalPipelineOptions,
        on_image: Callable[[], None] = lambda: None,
        start: pycolmap.Reconstruction | None = None,
    ) -> Mapped:
        """Maps from scratch, or adds images to `start`."""
        output = self.folder / name
        output.mkdir()
        options.ba_global_frames_ratio = options.ba_global_points_ratio = _GROWTH
        options.ba_global_max_refinements = _MOST_ROUNDS
        rigs.hold_rigs(options, database, self.entries)
        before = ""
        if start is not None:
            (output / "start").mkdir()
            start.write(output / "start")
            before = str(output / "start")
        return self._largest_first(
            pycolmap.incremental_mapping(
                database, self.images, output, options=options, input_path=before, next_image_callback=on_image
            )
        )

    def _largest_first(self, models: dict[int, pycolmap.Reconstruction]) -> Mapped:
        return Mapped(largest_first(models.values()), self._verified)

    def _better(self, best: Mapped, later: Mapped, held_out: PairMatches) -> Mapped:
        """Prefers `later` if it places more and explains about as much, or explains more."""
        if not best.models or not later.models:
            return best if best.models else later
        matches, matches_later = (self._verified.explained(some.models[0], held_out) for some in (best, later))
        if later.placed > best.placed:
            return later if matches_later >= _AS_GOOD * matches else best
        return later if matches_later * _AS_GOOD > matches else best

    def _left_out(self, best: Mapped) -> set[int]:
        """Ids of the unplaced images."""
        model = best.models[0] if best.models else None
        placed = set() if model is None else {image.image_id for image in model.images.values() if image.has_pose}
        files = {entry["file"] for entry in self.entries}
        with pycolmap.Database.open(self.database) as reader:
            return {image.image_id for image in reader.read_all_images() if image.name in files} - placed


def largest_first(models: Iterable[pycolmap.Reconstruction]) -> Models:
    """Sorts as `Models`, without those that a larger one contains, as of a pair from which the mapper began in vain."""
    ordered = sorted(models, key=lambda model: (-model.num_reg_images(), -model.num_points3D()))
    placed = [{image.image_id for image in model.images.values() if image.has_pose} for model in ordered]
    return [model for row, model in enumerate(ordered) if not any(placed[row] <= larger for larger in placed[:row])]


def strongest_pairs(matches: PairMatches, held_out: PairMatches, images: set[int]) -> list[tuple[int, int]]:
    """Chooses each image's strongest pairs by matches that are not held out, sorted.

    Pairs of two of `images` come last: a photo and its copy place neither.
    """
    of_image = defaultdict(list)
    for pair, rows in matches.items():
        for image_id in set(pair) & images:
            of_image[image_id].append((images >= set(pair), len(held_out.get(pair, ())) - len(rows), pair))
    strongest = {row for rows in of_image.values() for row in sorted(rows)[:_GUIDED_PAIRS_PER_IMAGE]}
    return sorted(pair for *_, pair in sorted(strongest)[:_MOST_GUIDED_PAIRS])


def map_possible(mapping: Mapping, global_images: int, max_side: int) -> tuple[Mapped, dict[str, NotPlaced]]:
    """Maps images without impossible ones; returns the reasons of those, by file.

    Maps again without them if others are unplaced, which they may have displaced.
    """
    mapped = mapping.run(global_images)
    _ = mapped.contradictions  # cached first: pairs with one unplaced image contradict a model, too
    impossible = take_out_impossible(mapped.models, max_side)
    models = largest_first(model for model in mapped.models if model.num_reg_images())
    left = len(mapping.entries) - len(impossible)
    if not impossible or left < 2 or (models and models[0].num_reg_images() >= left):
        mapped.models[:] = models
        return mapped, impossible
    mapped, more = map_possible(mapping.without(impossible), global_images, max_side)
    return mapped, impossible | more


def take_out_impossible(models: Sequence[pycolmap.Reconstruction], max_side: int) -> dict[str, NotPlaced]:
    """Removes impossible images, their observations, and points without a finite position.

    Returns:
        The reason by image name: "lens" or "unknown".
    """
    reasons: dict[str, NotPlaced] = {}
    for model in models:
        impossible = {number for number, camera in model.cameras.items() if not _is_possible(camera, max_side)}
        for image in [image for image in model.images.values() if image.has_pose]:
            if image.camera_id in impossible:
                reasons[image.name] = "lens"
            elif not np.isfinite(image.cam_from_world().matrix()).all():
                reasons[image.name] = "unknown"
            else:
                continue
            if image.has_pose:  # else removed with another image of its frame
                model.deregister_frame(image.frame_id)
        for number in [number for number, point in model.points3D.items() if not np.isfinite(point.xyz).all()]:
            model.delete_point3D(number)
    placed = {image.name for model in models for image in model.images.values() if image.has_pose}
    return {name: reason for name, reason in reasons.items() if name not in placed}


def _is_possible(camera: pycolmap.Camera, max_side: int) -> bool:
    if not np.isfinite(camera.params).all():
        return False
    if not _FOCAL_RANGE[0] <= rigs.relative_focal(camera) <= _FOCAL_RANGE[1]:
        return False
    params = tuple(float(value) for value in camera.params)
    camera_model = CameraModel(camera.model.name, camera.width, camera.height, params)
    try:
        check_camera_model(camera_model, field="camera")
        lens_of(camera_model, max_side, field="camera")
    except InvalidInputError:
        return False
    return True


def contradicting_pairs(matches: PairMatches, pixels: Lookup[int, NDArray[np.float32]]) -> list[tuple[int, int]]:
    """Chooses pairs to remove so that no cycle of three images contradicts itself.

    Greedy: the pair with the largest excess of contradicting over agreeing cycles; on ties, with fewest matches.
    """
    loops = _loops(matches, pixels)
    of_pair: dict[tuple[int, int], set[int]] = {pair: set() for pair in matches}
    votes, wrong_loops = dict.fromkeys(matches, 0), dict.fromkeys(matches, 0)
    for number, (pairs, agrees) in enumerate(loops):
        for pair in pairs:
            of_pair[pair].add(number)
            votes[pair] += -1 if agrees else 1
            wrong_loops[pair] += not agrees
    wrong = []
    while suspects := [pair for pair, count in wrong_loops.items() if count]:
        worst = max(suspects, key=lambda pair: (votes[pair], -len(matches[pair]), pair))
        wrong.append(worst)
        for number in of_pair[worst].copy():
            pairs, agrees = loops[number]
            for pair in pairs:
                of_pair[pair].remove(number)
                votes[pair] -= -1 if agrees else 1
                wrong_loops[pair] -= not agrees
    return sorted(wrong)


def _loops(matches: PairMatches, pixels: Lookup[int, NDArray[np.float32]]) -> list[tuple[_Pairs, bool]]:
    """Lists each cycle's pairs and whether it agrees; inconclusive ones are omitted."""
    followed, neighbors = {}, defaultdict(set)
    for (i, j), rows in matches.items():
        followed[i, j] = np.full(len(pixels[i]), -1, np.int32)
        followed[i, j][rows[:, 0]] = rows[:, 1]
        neighbors[i].add(j)
    loops = []
    for i, j in sorted(matches):
        for k in sorted(neighbors[i] & neighbors[j]):
            agrees = _agrees(followed[i, j], followed[j, k], followed[i, k], pixels[k])
            if agrees is not None:
                loops.append((((i, j), (j, k), (i, k)), agrees))
    return loops


def _agrees(
    first: NDArray[np.int32], second: NDArray[np.int32], direct: NDArray[np.int32], pixels: NDArray[np.float32]
) -> bool | None:
    """Checks if most features arrive at the same place; None if inconclusive."""
    rows = np.flatnonzero((first >= 0) & (direct >= 0))
    rows = rows[second[first[rows]] >= 0]
    if len(rows) < _FEWEST:
        return None
    apart = np.linalg.norm(pixels[second[first[rows]]] - pixels[direct[rows]], axis=1)
    return bool((apart <= _SAME_PX).mean() >= 0.5)
