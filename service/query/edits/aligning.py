"""Alignment of scenes to another frame: Gaussians and cameras rotated, scaled and shifted."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from fastsplat.service.common.combined_ratios import NORMAL_95
from fastsplat.service.common.similarity import Similarity, fit_similarity
from fastsplat.service.query.edits.gaussian_edits import moved_gaussians
from fastsplat.service.scene.artefact.alignment import Alignment as SceneAlignment
from fastsplat.service.scene.artefact.alignment import frame_name
from fastsplat.service.scene.artefact.frames import frame_of
from fastsplat.service.scene.artefact.scaling import ScaledLength, combined
from fastsplat.service.scene.artefact.scene import Gaussians, Scene
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from fastsplat_contract.geometry.camera import check_rigid
from fastsplat_contract.messages.scenes import Edit

if TYPE_CHECKING:
    from fastsplat.service.query.scene_index import SceneIndex

F64 = NDArray[np.float64]


def placed_gaussians(gaussians: Gaussians, change: Similarity) -> Gaussians:
    """Transforms Gaussians so that they look the same to a `Similarity.camera`."""
    if change.scale == 1.0 and np.array_equal(change.rotation, np.eye(3)) and not change.translation.any():
        return gaussians
    pose = np.eye(4)
    pose[:3, :3] = change.rotation
    scaled = replace(
        gaussians,
        means=np.asarray(change.scale * gaussians.means.astype(np.float64)),
        log_scales=(gaussians.log_scales.astype(np.float64) + math.log(change.scale)).astype(np.float32),
    )
    pose[:3, 3] = change.translation
    return moved_gaussians(scaled, pose)


def align_scene(index: SceneIndex, edit: Edit) -> Scene:
    """Moves the scene into the frame of a map; see `Alignment` of the contract.

    Raises:
        InvalidInputError: a label or objects; not exactly one of transform and pairs; fewer than three pairs, collinear
            or mirrored pairs, or pairs of which fewer than half agree; a transform that is not rigid.
        LimitExceededError: too many pairs, or too long a name.
    """
    order = edit.alignment
    assert order is not None
    if edit.label is not None or edit.object_ids:
        raise InvalidInputError("align is of the whole scene", field="label", hint="Send an alignment alone.")
    _check_frame(order.frame)
    if (order.transform is not None) == bool(order.pairs):
        raise InvalidInputError(
            "an alignment needs exactly one of transform and pairs",
            field="alignment",
            hint="Send a rigid motion, or three and more pairs of points.",
        )
    scene = index.objects.scene
    if order.transform is not None:
        pose = order.transform.matrix()
        check_rigid(pose, field="alignment.transform")
        change = Similarity(1.0, Rotation.from_matrix(pose[:3, :3]).as_matrix(), pose[:3, 3])
        return _placed(scene, change, order.frame, None)
    fit = fit_pairs(
        np.array([pair.scene for pair in order.pairs], np.float64),
        np.array([pair.map for pair in order.pairs], np.float64),
        scaled=scene.scale != "METRIC",
    )
    return _placed(scene, fit.change, order.frame, fit)


@dataclass(frozen=True)
class PairFit:
    """The best similarity from points of a scene to points of a map."""

    change: Similarity  # from the scene's frame into the map's
    residuals: F64  # float64 [N], of each pair, units of the map
    outliers: NDArray[np.bool_]  # bool [N], pairs that did not count
    spread: float  # root mean square distance of the scene's points that counted from their middle
    deviation: float  # relative, of the scale, 0 if not fitted; × 1.96: 95 % interval of Student's t for few pairs

    @property
    def rms(self) -> float:
        """Root mean square residual of the inliers, map units."""
        return float(np.sqrt((self.residuals[~self.outliers] ** 2).mean()))


def fit_pairs(scene: F64, world: F64, *, scaled: bool) -> PairFit:
    """Fits the least-squares similarity (rigid unless `scaled`) between point pairs [N, 3].

    After Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991. From
    five pairs on, outliers are those further than 3 robust deviations from the best motion through three pairs (least
    median of squares, Rousseeuw 1984). Errors as `align_scene`; at most 1,000 pairs."""
    count = len(scene)
    if count > _MOST_PAIRS:
        raise LimitExceededError(f"{count} pairs", field="alignment.pairs", limit=f"{_MOST_PAIRS} pairs")
    if count < _FEWEST_PAIRS or not (np.isfinite(scene).all() and np.isfinite(world).all()):
        raise InvalidInputError(
            f"{count} pairs" if count < _FEWEST_PAIRS else "a point that is not finite",
            field="alignment.pairs",
            limit="three or more, of finite numbers",
            hint="Pick three or more places that are far from each other and not on one line.",
        )
    _check_spread(scene, "scene")
    _check_spread(world, "map")
    counting = _agreeing(scene, world, scaled) if count >= _ROBUST_FROM else np.ones(count, np.bool_)
    _check_spread(scene[counting], "scene")
    offsets = scene[counting] - scene[counting].mean(axis=0)
    left, values, right = np.linalg.svd((world[counting] - world[counting].mean(axis=0)).T @ offsets)
    if np.linalg.det(left @ right) < 0 and values[2] > _MIRROR * values[0]:  # clearly better fitted by a reflection
        raise InvalidInputError(
            "the points of the map are a mirror image of those of the scene",
            field="alignment.pairs",
            hint="Both frames are right-handed: check the order and the signs of the map's axes.",
        )
    change = fit_similarity(scene[counting], world[counting], scaled=scaled)
    residuals = np.linalg.norm(change.points(scene) - world, axis=1)
    spread, used = float(np.sqrt((offsets**2).sum(axis=1).mean())), int(counting.sum())
    freedom = 3 * used - 7
    sigma = float(np.sqrt((residuals[counting] ** 2).sum() / freedom))
    deviation = sigma / (change.scale * spread * np.sqrt(used)) * float(student.ppf(0.975, freedom)) / NORMAL_95
    fit = PairFit(change, residuals, ~counting, spread, deviation if scaled else 0.0)
    if fit.rms > _WORST * change.scale * spread:
        raise _disagreeing()
    return fit


def _agreeing(scene: F64, world: F64, scaled: bool) -> NDArray[np.bool_]:
    """Selects the pairs that agree with each other, bool [N]."""
    count = len(scene)
    random = np.random.default_rng(0)
    triples = list(combinations(range(count), 3)) if count <= _EXHAUSTIVE else None
    if triples is None:
        triples = [tuple(random.choice(count, 3, replace=False)) for _ in range(_TRIALS)]
    half = (count + 4) // 2  # least median of squares with 4 points' freedom
    best, least = np.zeros(count), np.inf
    for triple in triples:
        rows = list(triple)
        if _flatness(scene[rows]) < _LINE or _flatness(world[rows]) < _LINE:
            continue
        residuals = np.linalg.norm(
            fit_similarity(scene[rows], world[rows], scaled=scaled).points(scene) - world, axis=1
        )
        value = float(np.sort(residuals)[min(half, count) - 1])
        if value < least:
            best, least = residuals, value
    extent = float(np.linalg.norm(np.ptp(world, axis=0)))
    sigma = max(_ROBUST * (1 + 5 / max(count - 3, 1)) * least, _EXACT * extent)
    counting = np.asarray(best <= _FAR * sigma)
    if counting.sum() < max(_FEWEST_PAIRS, count / 2):
        raise _disagreeing()
    return counting


def _disagreeing() -> InvalidInputError:
    return InvalidInputError(
        "fewer than half of the pairs agree with each other",
        field="alignment.pairs",
        limit=f"a root mean square of {_WORST:g} of the points' own spread",
        hint="Check which point of the scene belongs to which of the map, and the order of the axes.",
    )


def _flatness(points: F64) -> float:
    """Ratio of the second to the largest singular value; 0: collinear or a single point."""
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(values[1] / values[0]) if values[0] > 0 else 0.0


def _check_spread(points: F64, what: str) -> None:
    if _flatness(points) < _LINE:
        raise InvalidInputError(
            f"the points of the {what} lie on one line, or are one",
            field="alignment.pairs",
            limit=f"a width of {_LINE:g} of their length",
            hint="Add a place well beside that line.",
        )


def _check_frame(name: str) -> None:
    if len(name) > _MOST_CHARS:
        raise LimitExceededError(
            f"a frame's name of {len(name)} characters", field="alignment.frame", limit=f"{_MOST_CHARS} characters"
        )
    if name and not name.isprintable():
        raise InvalidInputError("a frame's name of control characters", field="alignment.frame", limit="one line")


def _placed(scene: Scene, change: Similarity, frame: str, fit: PairFit | None) -> Scene:
    whole = change.after(frame_of(scene))
    x, y, z = (float(value) for value in whole.translation)
    first, second, third = ((float(a), float(b), float(c)) for a, b, c in whole.rotation)
    scales = fit is not None and scene.scale != "METRIC"
    alignment = SceneAlignment(
        frame=frame,
        rotation=(first, second, third),
        translation=(x, y, z),
        pairs=0 if fit is None else len(fit.residuals),
        residuals=() if fit is None else tuple(float(value) for value in fit.residuals),
        rms=None if fit is None else fit.rms,
        outliers=() if fit is None else tuple(np.flatnonzero(fit.outliers).tolist()),
        scaled=scales or (scene.alignment is not None and scene.alignment.scaled),
    )
    scaling = scene.scaling
    if scales and fit is not None:
        length = ScaledLength(fit.spread, fit.spread * fit.deviation, fit.spread * change.scale, 0.0)
        scaling = combined([length])
    into = replace(change, frame_id=frame_name(alignment))
    return replace(
        scene,
        gaussians=placed_gaussians(scene.gaussians, change),
        cameras=tuple(into.camera(posed) for posed in scene.cameras),
        scale="METRIC" if scales else scene.scale,
        scaling=scaling,
        alignment=alignment,
    )


_MOST_CHARS = 200
_FEWEST_PAIRS, _MOST_PAIRS = 3, 1_000
_ROBUST_FROM = 5
"""With four pairs an outlier cannot be told from a bad fit."""
_EXHAUSTIVE, _TRIALS = 12, 500
_LINE = 0.02
_WORST = 0.2
_MIRROR = 1e-3
_ROBUST, _FAR = 1.4826, 3.0
_EXACT = 1e-6
