"""Objects of one scene: listing, masks and lookup; see `picking` for selection at a place."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fastsplat.service.common.cache import LeastRecentlyUsed
from fastsplat.service.query.objects.absence import UnseenSpace
from fastsplat.service.query.objects.floors import with_floors_judged
from fastsplat.service.query.objects.names.merged_suggestions import OWN_SOURCE, MergedName, Trust, merged_suggestions
from fastsplat.service.query.objects.names.object_names import ObjectNames
from fastsplat.service.query.objects.object_history import SceneHistory
from fastsplat.service.query.objects.object_measures import Extent, ObjectMeasures, extents_of
from fastsplat.service.query.objects.solid_gaussians import grouped_rows, masses, solid_rows
from fastsplat.service.query.objects.unseen_space import surface_kind, unseen_space
from fastsplat.service.query.objects.visibility import best_views
from fastsplat.service.scene.artefact.scene import Object, ObjectGroup, Objects, ObjectScene, Parts
from fastsplat.service.scene.objects.label_evidence import Posterior, posterior
from fastsplat.service.scene.objects.objects import part_rows
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.messages.objects import NameSuggestion, SceneObject, SuggestionSource

ObjectMap = NDArray[np.uint16]

KEPT_MAP_BYTES = 32 << 20
"""Limit per open scene: 8 maps of 1920×1080 pixels, or one of 4096×4096."""


_NEAREST = 8
_REACH = 3.0
"""Standard deviations of a Gaussian within which a point is at it."""

_OF_MEMBERSHIP = (
    "belief", "owner", "counts", "part_owner", "extents", "_best_views", "unseen", "_solid", "_maps",
    "views_of_objects", "measures",
)  # fmt: skip
"""Attributes that do not depend on names, so that they survive a renaming."""


class SceneObjects:
    """Objects of a scene, ready for queries; thread-safe.

    Args:
        draw: renders the object or part of each pixel of a view, 0 for none.
        before: those of the scene before an edit; reused where only names changed.
    """

    def __init__(
        self,
        scene: ObjectScene,
        stored: bool,  # the scene's file has them
        draw: Callable[[PosedCamera, Objects | Parts], ObjectMap],
        history: SceneHistory,
        before: SceneObjects | None = None,
    ) -> None:
        self.scene = scene
        self.history = history
        self.stored = stored
        self.table = scene.objects
        self._draw = draw
        same = before is not None and before.scene.gaussians is scene.gaussians
        if before is not None and same and _same_members(before.table, scene.objects):
            known = vars(before)
            vars(self).update({name: known[name] for name in _OF_MEMBERSHIP if name in known})

    @cached_property
    def belief(self) -> Posterior:
        """The probability of each Gaussian's objects."""
        return posterior(self.table.membership, max((obj.id for obj in self.table.table), default=0) + 1)

    @cached_property
    def owner(self) -> NDArray[np.int32]:
        """Object of each Gaussian, int32 [G], 0 for none."""
        return self.belief.classes

    @cached_property
    def counts(self) -> NDArray[np.int64]:
        """Number of Gaussians by object id, int64 [I + 1]; [0]: those of none."""
        size = max((obj.id for obj in self.table.table), default=0) + 1
        return np.bincount(self.owner, minlength=size)

    @cached_property
    def part_owner(self) -> NDArray[np.int32]:
        """Part of each Gaussian, int32 [G], 0 for none."""
        return part_rows(self.table)

    @cached_property
    def part_counts(self) -> NDArray[np.int64]:
        """Number of Gaussians by part id, int64; [0]: those of none."""
        size = max((obj.id for obj in self.table.everything), default=0) + 1
        return np.bincount(self.part_owner, minlength=size)

    @cached_property
    def present_parts(self) -> tuple[Object, ...]:
        """Parts that have Gaussians, by parent, then by id."""
        parts = () if self.table.parts is None else self.table.parts.table
        return tuple(sorted((part for part in parts if self.part_counts[part.id]), key=lambda part: part.parent))

    @cached_property
    def present(self) -> tuple[Object, ...]:
        """Objects that have Gaussians, by id; floors are re-judged in every version."""
        here = [obj for obj in self.table.table if self.counts[obj.id]]
        return with_floors_judged(self.scene, here, self.owner)

    @cached_property
    def unseen(self) -> UnseenSpace:
        """Unseen space of the place."""
        surfaces = {obj.id: surface_kind(obj.name, obj.surface) for obj in self.present}
        return unseen_space(self.scene, self.owner, surfaces)

    @cached_property
    def groups(self) -> Mapping[int, ObjectGroup]:
        """Groups with at least two present members, by id, with these members."""
        here = {obj.id for obj in self.present}
        left = [(group, tuple(member for member in group.members if member in here)) for group in self.table.groups]
        return {group.id: replace(group, members=members) for group, members in left if len(members) > 1}

    @cached_property
    def measures(self) -> ObjectMeasures:
        """Measurements of objects and parts, made on first use."""
        return ObjectMeasures(self.scene, (self.owner, self.part_owner))

    @cached_property
    def names(self) -> ObjectNames:
        """Their names, without per-Gaussian data and pictures."""
        present, parts = (
            tuple(replace(obj, picture=b"") for obj in objects) for objects in (self.present, self.present_parts)
        )
        counts = {obj.id: int(self.counts[obj.id]) for obj in present}
        counts |= {part.id: int(self.part_counts[part.id]) for part in parts}
        return ObjectNames(
            self.scene.dictionary,
            present,
            parts,
            self.scene.facts.searched_names,
            counts=counts,
            searched_for=self.scene.facts.searched_for or (),
            boxes={object_id: extent.box for object_id, extent in self.extents.items()},
            metric=self.scene.scale == "METRIC",
        )

    @property
    def by_label(self) -> Mapping[int, tuple[int, ...]]:
        return self.names.by_label

    @cached_property
    def listed(self) -> tuple[SceneObject, ...]:
        """All objects that have Gaussians, by id."""
        parts: dict[int, list[int]] = {}
        for part in self.present_parts:
            parts.setdefault(part.parent, []).append(part.id)
        return tuple(self._described(obj, self.counts, tuple(parts.get(obj.id, ()))) for obj in self.present)

    @cached_property
    def listed_parts(self) -> tuple[SceneObject, ...]:
        """All parts that have Gaussians, ordered as `present_parts`."""
        return tuple(self._described(part, self.part_counts, ()) for part in self.present_parts)

    @cached_property
    def listed_with_parts(self) -> tuple[SceneObject, ...]:
        """All objects that have Gaussians, by id, each followed by its parts."""
        by_id = {part.id: part for part in self.listed_parts}
        return tuple(listed for obj in self.listed for listed in (obj, *(by_id[part_id] for part_id in obj.parts)))

    def get(self, object_id: int) -> SceneObject:
        """Returns a listed object or part, or raises NotFoundError."""
        self.check_all((object_id,))
        return next(obj for obj in (*self.listed, *self.listed_parts) if obj.id == object_id)

    def check_all(self, object_ids: Sequence[int], field: str = "object_ids") -> None:
        """Raises NotFoundError unless each id is a present object or part."""
        here = {obj.id for obj in (*self.present, *self.present_parts)}
        for number, object_id in enumerate(object_ids):
            if object_id not in here:
                raise NotFoundError(
                    f"there is no object {str(object_id)[:40]} in this version of the scene",
                    field=f"{field}[{number}]",
                    hint="List the scene's objects.",
                )

    def with_members(self, ids: Sequence[int], field: str = "object_ids") -> tuple[int, ...]:
        """Expands group ids to members; raises NotFoundError for unknown ids."""
        self.check_all([object_id for object_id in ids if object_id not in self.groups], field)
        return self._members(ids)

    def _members(self, ids: Sequence[int]) -> tuple[int, ...]:
        expansions = [self.groups[object_id].members if object_id in self.groups else (object_id,) for object_id in ids]
        return tuple(dict.fromkeys(member for members in expansions for member in members))

    def map(self, posed: PosedCamera) -> ObjectMap:
        """Object of each pixel, uint16 [H, W], 0 for none; cached."""
        return self._map(posed, self.table)

    def part_map(self, posed: PosedCamera) -> ObjectMap:
        """Part of each pixel, uint16 [H, W], 0 for none; cached."""
        if self.table.parts is None:
            return np.zeros((posed.camera.height, posed.camera.width), np.uint16)
        return self._map(posed, self.table.parts)

    def mask(self, posed: PosedCamera, object_ids: Sequence[int]) -> NDArray[np.bool_]:
        """Mask of objects, parts or groups in a view, bool [H, W]."""
        ids = self._members(object_ids)
        inside = np.isin(self.map(posed), ids)
        if any(part.id in ids for part in self.present_parts):
            inside |= np.isin(self.part_map(posed), ids)
        return np.asarray(inside)

    def rows(self, object_ids: Sequence[int]) -> NDArray[np.bool_]:
        """Selects Gaussians of objects, parts or groups, bool [G]."""
        ids = self._members(object_ids)
        inside = np.isin(self.owner, ids)
        return np.asarray(inside | np.isin(self.part_owner, ids) if self.present_parts else inside)

    @cached_property
    def views_of_objects(self) -> dict[int, tuple[str, ...]]:
        """Cache of `object_detections`: cameras that see each object; survives renaming."""
        return {}

    @cached_property
    def _maps(self) -> LeastRecentlyUsed[Hashable, ObjectMap]:
        return LeastRecentlyUsed(KEPT_MAP_BYTES)

    def _map(self, posed: PosedCamera, of: Objects | Parts) -> ObjectMap:
        key = (posed.camera, posed.world_from_camera.tobytes(), isinstance(of, Parts))
        return self._maps.get(key, lambda: 2 * posed.camera.width * posed.camera.height, lambda: self._draw(posed, of))

    def rows_at(self, point: Vector3) -> NDArray[np.int64]:
        """Nearest visible Gaussians (at most eight) at a finite point, nearest first, int64.

        A Gaussian is at the point within three of its largest standard deviations."""
        place = np.array(point, dtype=np.float64)
        if not np.isfinite(place).all():
            raise InvalidInputError(f"a point at {tuple(point)}", field="point", hint="Send finite numbers.")
        tree, rows, reach = self._solid
        if tree is not None:
            distance, near = tree.query(place, k=min(_NEAREST, len(rows)))
            distance, near = np.atleast_1d(distance), np.atleast_1d(near)
            return np.asarray(rows[near[distance <= reach[near]]])
        return np.zeros(0, np.int64)

    @cached_property
    def _solid(self) -> tuple[cKDTree | None, NDArray[np.int64], NDArray[np.float64]]:
        rows = solid_rows(self.scene.gaussians)
        reach = _REACH * np.exp(self.scene.gaussians.log_scales[rows].astype(np.float64).max(axis=1, initial=-np.inf))
        return (cKDTree(self.scene.gaussians.means[rows]) if len(rows) else None), rows, reach

    @cached_property
    def extents(self) -> Mapping[int, Extent]:
        """Extents of each visible object and part, by id."""
        parts = extents_of(self.scene, self.part_owner) if self.present_parts else {}
        return {**extents_of(self.scene, self.owner), **parts}

    def best_views(self, object_ids: Sequence[int]) -> Mapping[int, tuple[str, ...]]:
        """Names of at most five best cameras for each object or part, see `visibility`."""
        missing = {object_id for object_id in object_ids if object_id not in self._best_views}
        if missing:
            gaussians, solid = self.scene.gaussians, solid_rows(self.scene.gaussians)
            owners = (self.owner, self.part_owner) if self.present_parts else (self.owner,)
            by_id = dict(entry for owner in owners for entry in grouped_rows(owner, solid))
            groups = {object_id: rows for object_id, rows in by_id.items() if object_id in missing}
            views = best_views(self.scene, [*groups.values()], masses(gaussians.log_scales, gaussians.logit_opacities))
            self._best_views.update(zip(groups, views, strict=True))
        return self._best_views

    @cached_property
    def _best_views(self) -> dict[int, tuple[str, ...]]:
        return {}

    def _described(self, obj: Object, counts: NDArray[np.int64], parts: tuple[int, ...]) -> SceneObject:
        extent = self.extents.get(obj.id)
        return SceneObject(
            id=obj.id,
            name=obj.name,
            source=obj.source,
            probability=obj.probability,
            suggestions=listed_suggestions(obj, self.names.trust),
            kind="part" if obj.parent else "surface" if obj.surface else "object",
            surface=obj.surface,
            consensus=obj.consensus,
            gaussian_count=int(counts[obj.id]),
            box=None if extent is None else extent.box,
            meters=self.scene.scale == "METRIC",
            parent=obj.parent,
            parts=parts,
            centroid=None if extent is None else extent.centroid,
            guess=obj.guessed,
            groups=tuple(group.id for group in self.groups.values() if obj.id in group.members),
            reads=obj.reads,
            last_seen=self.history.last_seen(obj.parent or obj.id),
            missing_since=self.history.missing_since(obj.parent or obj.id),
            seen_in=self.history.seen_in(obj.parent or obj.id),
            label_id=self.scene.dictionary.id_of(obj.name) or 0 if obj.name else 0,
        )


def listed_suggestions(obj: Object, trust: Trust) -> tuple[NameSuggestion, ...]:
    """Suggested names of an object as listed in answers, most probable first."""
    return tuple(map(_name_suggestion, merged_suggestions(obj, trust)))


def _name_suggestion(name: MergedName) -> NameSuggestion:
    said_by = (SuggestionSource(said.source or OWN_SOURCE, said.model, said.probability) for said in name.suggestions)
    return NameSuggestion(name.name, name.probability, "", name.aliases, tuple(said_by))


def _same_members(first: Objects, second: Objects) -> bool:
    parts = [None if objects.parts is None else objects.parts.membership for objects in (first, second)]
    return first.membership is second.membership and parts[0] is parts[1]
