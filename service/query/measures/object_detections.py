"""Detections for robots: each object's pose with covariance, support, and views."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.measures.object_extents import side_deviations
from fastsplat.service.query.objects.object_index import SceneObjects
from fastsplat.service.query.objects.object_measures import ObjectShape
from fastsplat.service.query.objects.solid_gaussians import masses
from fastsplat.service.query.objects.visibility import view_scores
from fastsplat.service.query.phrases.relations import Judged, is_in
from fastsplat.service.query.phrases.stacks import PairBudget, Stacks, bounds_overlap
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scaling import capture_scaling
from fastsplat.service.scene.artefact.scene import Object, Scene
from fastsplat.service.scene.objects.boxes import BOX_TRIM, trimmed_ends
from fastsplat_contract.geometry.poses import Box, rigid, vector3
from fastsplat_contract.messages.detections import CovarianceTerm, Detection, DetectionList, Support, SupportRelation
from fastsplat_contract.messages.objects import SceneObject

_HOLDS = 1.0
_FLAT = ("wall", "ceiling")
_FLAT_SHARE = 0.2
"""Objects flatter than this, relative to width, hold nothing (table 0.09, plate 0.26, bowl 0.4)."""


def carrier_of(objects: SceneObjects, object_id: int) -> Support | None:
    """The clearest support of an object: below or around it, else a wall or ceiling.

    None if nothing is clear, and for a floor, a wall or a ceiling itself. Cancellable; LimitExceededError for too many
    pairs."""
    by_id = {obj.id: obj for obj in objects.present}
    subject = objects.measures.shape(object_id)
    if subject is None or by_id[object_id].surface in ("floor", *_FLAT):
        return None
    stacks = Stacks(objects.measures, by_id, PairBudget())
    shapes = [shape for key in by_id if key != object_id and (shape := objects.measures.shape(key)) is not None]
    beneath = (shape for shape in shapes if shape.low < subject.high and bounds_overlap(subject, shape))
    below = [shape for shape in beneath if by_id[shape.id].surface not in _FLAT]
    best = _clearest(judged for shape in below for judged in _carried(stacks, subject, shape))
    if best is None:
        walls = [wall for wall in shapes if by_id[wall.id].surface in _FLAT and _overlapping(subject, wall)]
        best = _clearest((wall.id, "on", stacks.rests_on(subject, wall)) for wall in walls)
    return None if best is None else Support(best[0], by_id[best[0]].name, *best[1:])


def _carried(stacks: Stacks, subject: ObjectShape, base: ObjectShape) -> Iterator[tuple[int, SupportRelation, Judged]]:
    check_cancelled()
    yield base.id, "on", stacks.direct(subject, base)
    # A table top's blurred surface may enclose what lies on it, so flat objects carry "on" only.
    flat = base.high - base.low < _FLAT_SHARE * base.width
    yield base.id, "on" if flat else "in", is_in(subject, base)


def _clearest(judged: Iterator[tuple[int, SupportRelation, Judged]]) -> tuple[int, SupportRelation, float] | None:
    candidates = [(carrier, relation, judgement.clearness) for carrier, relation, judgement in judged]
    best = max(candidates, key=lambda candidate: candidate[2], default=None)
    return best if best is not None and best[2] >= _HOLDS else None


def _overlapping(subject: ObjectShape, wall: ObjectShape) -> bool:
    """True if a wall is nearer along each axis than the object is wide."""
    low, high = wall.bounds[0] - subject.width, wall.bounds[1] + subject.width
    return bool((subject.bounds[0] <= high).all() and (low <= subject.bounds[1]).all())


F64 = NDArray[np.float64]

_MOST_VIEWS = 256
_SEES = 0.1
"""Least share of the best view's score for a camera to see an object."""
_TURNS = np.radians(np.arange(-45.0, 45.0, 3.0))
_NO_HEADING = np.radians(20.0)
"""Most deviation of a known heading; uniform angles within ±45° have 26°."""


def detections_of(index: SceneIndex, listed: Sequence[SceneObject], version: str, next_page: str = "") -> DetectionList:
    """Describes listed objects (no parts) of a scene for a robot; cancellable."""
    scene, table = index.scene, {obj.id: obj for obj in index.objects.table.table}
    up = index.objects.measures.up
    seen = _views_of(index)
    carriers = {obj.id: carrier_of(index.objects, obj.id) for obj in listed} if up is not None else {}
    detections = []
    for obj in listed:
        check_cancelled()
        detections.append(_detection(index, obj, table[obj.id], carriers.get(obj.id), seen.get(obj.id, ())))
    vertical, meters = None if up is None else vector3(up), scene.scale == "METRIC"
    return DetectionList(tuple(detections), next_page, version, scene.frame_id, meters, vertical)


def _detection(
    index: SceneIndex, obj: SceneObject, stored: Object, support: Support | None, views: tuple[str, ...]
) -> Detection:
    position: tuple[float, ...] = ()
    rotation: tuple[float, ...] = ()
    terms: tuple[CovarianceTerm, ...] = ()
    shape = index.objects.measures.shape(obj.id)
    deviations = None if obj.box is None else side_deviations(index, obj.id, obj.box)
    if obj.box is not None and deviations is not None:
        covariance, terms = position_covariance(index, obj.id, obj.box, deviations)
        position = tuple(covariance.ravel().tolist())
        turns = None if shape is None else rotation_covariance(index, shape, obj.box, deviations)
        rotation = () if turns is None else tuple(turns.ravel().tolist())
    first, last = _seen_between(index.scene, views)
    names = [posed.name for posed in index.scene.cameras]
    return Detection(
        object_id=obj.id,
        label=obj.name,
        source=obj.source,
        probability=obj.probability if obj.name else None,
        alternatives=obj.suggestions,
        kind=obj.kind,
        box=obj.box,
        position_covariance=position,
        rotation_covariance=rotation,
        covariance_terms=terms,
        support=support,
        views=views,
        proposed_in=_named(names, stored.proposed_in),
        missed_in=_named(names, stored.missed_in),
        consensus=obj.consensus if index.objects.stored else None,
        first_seen=first,
        last_seen=last,
    )


def position_covariance(
    index: SceneIndex, object_id: int, box: Box, deviations: tuple[float, float, float]
) -> tuple[F64, tuple[CovarianceTerm, ...]]:
    """Covariance of a box's center [3, 3], scene units squared, and its terms.

    Σ = R diag((σ_i / 2)² + d_i²) Rᵀ + δ² (c − t)(c − t)ᵀ + ρ² / 3 · I: R the box's axes, σ_i the deviation of side i
    (both ends, so half of it for the middle), d_i the shift of the middle along axis i if each Gaussian is weighted
    with its membership probability (the share of agreeing views), c the box's center, δ the relative deviation of the
    scale, t the origin of the trained scene (from which lengths are scaled), ρ the RMS of the map alignment's point
    pairs. Unknown errors are left out: photo poses and given motions count as exact."""
    scene, objects = index.scene, index.objects
    pose = rigid(box.center.orientation, box.center.position)
    axes, variances = pose[:3, :3], (np.array(deviations) / 2) ** 2
    terms: list[CovarianceTerm] = ["edges"]
    if objects.stored:
        terms.append("membership")
        rows = np.flatnonzero(objects.owner == object_id)
        along = (scene.gaussians.means[rows].astype(np.float64) - pose[:3, 3]) @ axes
        weights = masses(scene.gaussians.log_scales[rows], scene.gaussians.logit_opacities[rows])
        sure = weights * objects.belief.confidence[rows]
        if sure.any():
            middles = [[sum(trimmed_ends(values, by)) / 2 for values in along.T] for by in (weights, sure)]
            variances = variances + (np.array(middles[1]) - np.array(middles[0])) ** 2
    covariance = axes @ np.diag(variances) @ axes.T
    scaling = scene.scaling or capture_scaling(scene.facts)
    if scene.scale == "METRIC" and scaling is not None:
        terms.append("scale")
        origin = np.zeros(3) if scene.alignment is None else np.array(scene.alignment.translation)
        arm = scaling.deviation * (pose[:3, 3] - origin)
        covariance = covariance + np.outer(arm, arm)
    if scene.alignment is not None and scene.alignment.rms is not None:
        terms.append("alignment")
        covariance = covariance + scene.alignment.rms**2 / 3 * np.eye(3)
    return (covariance + covariance.T) / 2, tuple(terms)


def rotation_covariance(
    index: SceneIndex, shape: ObjectShape, box: Box, deviations: tuple[float, float, float]
) -> F64 | None:
    """Covariance of an upright box's orientation [3, 3], radians squared, about the world axes.

    None if up is unknown or the heading is undetermined. Σ = σ_h² u uᵀ + σ_t² / 2 (I − u uᵀ): σ_t the deviation of the
    vertical u (`Scene.vertical`, over both directions across it); σ_h the RMS of the turns θ from the box's heading,
    within ±45° in steps of 3°, at which a bounding rectangle is no larger than the smallest by more than its sides'
    uncertainty: A(θ) ≤ A_min + √((b σ_a)² + (a σ_b)²), a and b the smallest one's sides; 3° / √12 is added for the
    steps."""
    measures = index.objects.measures
    known = index.scene.vertical()
    if known is None or measures.up is None:
        return None
    ahead = measures.axes[:2] @ rigid(box.center.orientation, box.center.position)[:3, 0]
    angles = float(np.arctan2(ahead[1], ahead[0])) + _TURNS
    flat = shape.points[:, :2]
    along = flat @ np.stack([np.cos(angles), np.sin(angles)])
    aside = flat @ np.stack([-np.sin(angles), np.cos(angles)])
    ends = np.quantile(np.stack([along, aside]), [BOX_TRIM, 1 - BOX_TRIM], axis=1)
    sides = ends[1] - ends[0]  # [2, turns]
    areas = sides[0] * sides[1]
    best = int(areas.argmin())
    unsure = float(np.hypot(sides[1, best] * deviations[0], sides[0, best] * deviations[1]))
    alike = _TURNS[areas <= areas[best] + unsure]
    heading = float(np.sqrt((alike**2).mean() + (_TURNS[1] - _TURNS[0]) ** 2 / 12))
    if heading >= _NO_HEADING:
        return None
    tilt = float(np.radians(known.deviation_deg))
    vertical = np.outer(measures.up, measures.up)
    return np.asarray(heading**2 * vertical + tilt**2 / 2 * (np.eye(3) - vertical))


def _views_of(index: SceneIndex) -> Mapping[int, tuple[str, ...]]:
    """Names of the cameras (at most 256) that see each object, best first; cached."""
    cache = index.objects.views_of_objects
    if not cache and index.objects.present:
        scene = index.scene
        ids = [obj.id for obj in index.objects.present]
        rows = [np.flatnonzero(index.objects.owner == object_id) for object_id in ids]
        weights = masses(scene.gaussians.log_scales, scene.gaussians.logit_opacities)
        views, scores = view_scores(scene, rows, weights, _MOST_VIEWS)
        check_cancelled()
        for object_id, row in zip(ids, scores, strict=True):
            least = _SEES * row.max(initial=0.0)
            order = [number for number in (-row).argsort(kind="stable").tolist() if row[number] > 0]
            cache[object_id] = tuple(views[number].name for number in order if row[number] >= least)
    return cache


def _named(names: Sequence[str], numbers: Sequence[int]) -> tuple[str, ...]:
    return tuple(names[number] for number in numbers if number < len(names))


def _seen_between(scene: Scene, views: Sequence[str]) -> tuple[datetime | None, datetime | None]:
    """Times of the first and last photo of these views, if known."""
    taken = scene.facts.taken_at or {}
    times = [taken[name] for name in views if name in taken]
    if not times:
        return None, None
    return datetime.fromtimestamp(min(times), UTC), datetime.fromtimestamp(max(times), UTC)
