"""Things of one scene: listing, masks and lookup; see `picking` for selection at a place."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fastsplat.service.query.things.absence import UnseenSpace
from fastsplat.service.query.things.floors import with_floors_judged
from fastsplat.service.query.things.kept_maps import KeptMaps, ThingMap
from fastsplat.service.query.things.names.merged_suggestions import OWN_SOURCE, MergedName, Trust, merged_suggestions
from fastsplat.service.query.things.names.thing_names import ThingNames
from fastsplat.service.query.things.solid_gaussians import grouped_rows, masses, solid_rows
from fastsplat.service.query.things.thing_history import SceneHistory
from fastsplat.service.query.things.thing_measures import Extent, ThingMeasures, extents_of
from fastsplat.service.query.things.unseen_space import surface_kind, unseen_space
from fastsplat.service.query.things.visibility import best_views
from fastsplat.service.scene.artefact.scene import Parts, Thing, ThingGroup, Things, ThingScene
from fastsplat.service.scene.objects.label_evidence import Posterior, posterior
from fastsplat.service.scene.objects.things import part_rows
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.messages.things import NameSuggestion, SceneThing, SuggestionSource

_NEAREST = 8
_REACH = 3.0
"""Standard deviations of a Gaussian within which a point is at it."""

_OF_MEMBERSHIP = (
    "belief",
    "owner",
    "counts",
    "part_owner",
    "extents",
    "_best_views",
    "unseen",
    "_solid",
    "_maps",
    "views_of_things",
    "measures",
)
"""Attributes that do not depend on names, so that they survive a renaming."""


class SceneThings:
    """Things of a scene, ready for queries; thread-safe.

    Args:
        draw: renders the thing or part of each pixel of a view, 0 for none.
        before: those of the scene before an edit; reused where only names changed.
    """

    def __init__(
        self,
        scene: ThingScene,
        stored: bool,  # the scene's file has them
        draw: Callable[[PosedCamera, Things | Parts], ThingMap],
        history: SceneHistory,
        before: SceneThings | None = None,
    ) -> None:
        self.scene = scene
        self.history = history
        self.stored = stored
        self.table = scene.things
        self._draw = draw
        same = before is not None and before.scene.gaussians is scene.gaussians
        if before is not None and same and _same_members(before.table, scene.things):
            known = vars(before)
            vars(self).update({name: known[name] for name in _OF_MEMBERSHIP if name in known})

    @cached_property
    def belief(self) -> Posterior:
        """The probability of each Gaussian's things."""
        return posterior(self.table.membership, max((thing.id for thing in self.table.table), default=0) + 1)

    @cached_property
    def owner(self) -> NDArray[np.int32]:
        """Thing of each Gaussian, int32 [G], 0 for none."""
        return self.belief.classes

    @cached_property
    def counts(self) -> NDArray[np.int64]:
        """Number of Gaussians by thing id, int64 [I + 1]; [0]: those of none."""
        size = max((thing.id for thing in self.table.table), default=0) + 1
        return np.bincount(self.owner, minlength=size)

    @cached_property
    def part_owner(self) -> NDArray[np.int32]:
        """Part of each Gaussian, int32 [G], 0 for none."""
        return part_rows(self.table)

    @cached_property
    def part_counts(self) -> NDArray[np.int64]:
        """Number of Gaussians by part id, int64; [0]: those of none."""
        size = max((thing.id for thing in self.table.everything), default=0) + 1
        return np.bincount(self.part_owner, minlength=size)

    @cached_property
    def present_parts(self) -> tuple[Thing, ...]:
        """Parts that have Gaussians, by parent, then by id."""
        parts = () if self.table.parts is None else self.table.parts.table
        return tuple(sorted((part for part in parts if self.part_counts[part.id]), key=lambda part: part.parent))

    @cached_property
    def present(self) -> tuple[Thing, ...]:
        """Things that have Gaussians, by id; floors are re-judged in every version."""
        here = [thing for thing in self.table.table if self.counts[thing.id]]
        return with_floors_judged(self.scene, here, self.owner)

    @cached_property
    def unseen(self) -> UnseenSpace:
        """Unseen space of the place."""
        surfaces = {thing.id: surface_kind(thing.name, thing.surface) for thing in self.present}
        return unseen_space(self.scene, self.owner, surfaces)

    @cached_property
    def groups(self) -> Mapping[int, ThingGroup]:
        """Groups with at least two present members, by id, with these members."""
        here = {thing.id for thing in self.present}
        own = {group.id: tuple(member for member in group.members if member in here) for group in self.table.groups}
        return {each.id: replace(each, members=own[each.id]) for each in self.table.groups if len(own[each.id]) > 1}

    @cached_property
    def measures(self) -> ThingMeasures:
        """Measurements of things and parts, made on first use."""
        return ThingMeasures(self.scene, (self.owner, self.part_owner))

    @cached_property
    def names(self) -> ThingNames:
        """Their names, without per-Gaussian data and pictures."""
        present, parts = (
            tuple(replace(thing, picture=b"") for thing in things) for things in (self.present, self.present_parts)
        )
        counts = {each.id: int(self.counts[each.id]) for each in present}
        counts |= {part.id: int(self.part_counts[part.id]) for part in parts}
        return ThingNames(
            self.scene.dictionary,
            present,
            parts,
            self.scene.facts.searched_names,
            counts=counts,
            searched_for=self.scene.facts.searched_for or (),
            boxes={each: extent.box for each, extent in self.extents.items()},
            metric=self.scene.scale == "METRIC",
        )

    @property
    def by_label(self) -> Mapping[int, tuple[int, ...]]:
        return self.names.by_label

    @cached_property
    def listed(self) -> tuple[SceneThing, ...]:
        """All things that have Gaussians, by id."""
        parts: dict[int, list[int]] = {}
        for part in self.present_parts:
            parts.setdefault(part.parent, []).append(part.id)
        return tuple(self._described(thing, self.counts, tuple(parts.get(thing.id, ()))) for thing in self.present)

    @cached_property
    def listed_parts(self) -> tuple[SceneThing, ...]:
        """All parts that have Gaussians, ordered as `present_parts`."""
        return tuple(self._described(part, self.part_counts, ()) for part in self.present_parts)

    @cached_property
    def listed_with_parts(self) -> tuple[SceneThing, ...]:
        """All things that have Gaussians, by id, each followed by its parts."""
        by_id = {part.id: part for part in self.listed_parts}
        return tuple(
            listed for thing in self.listed for listed in (thing, *(by_id[part_id] for part_id in thing.parts))
        )

    def get(self, thing_id: int) -> SceneThing:
        """Returns a listed thing or part, or raises NotFoundError."""
        self.check_all((thing_id,))
        return next(thing for thing in (*self.listed, *self.listed_parts) if thing.id == thing_id)

    def check_all(self, thing_ids: Sequence[int], field: str = "thing_ids") -> None:
        """Raises NotFoundError unless each id is a present thing or part."""
        here = {thing.id for thing in (*self.present, *self.present_parts)}
        for number, thing_id in enumerate(thing_ids):
            if thing_id not in here:
                raise NotFoundError(
                    f"there is no thing {str(thing_id)[:40]} in this version of the scene",
                    field=f"{field}[{number}]",
                    hint="List the scene's things.",
                )

    def with_members(self, ids: Sequence[int], field: str = "thing_ids") -> tuple[int, ...]:
        """Expands group ids to members; raises NotFoundError for unknown ids."""
        self.check_all([each for each in ids if each not in self.groups], field)
        return self._members(ids)

    def _members(self, ids: Sequence[int]) -> tuple[int, ...]:
        own = [self.groups[each].members if each in self.groups else (each,) for each in ids]
        return tuple(dict.fromkeys(member for members in own for member in members))

    def map(self, posed: PosedCamera) -> ThingMap:
        """Thing of each pixel, uint16 [H, W], 0 for none; cached."""
        return self._map(posed, self.table)

    def part_map(self, posed: PosedCamera) -> ThingMap:
        """Part of each pixel, uint16 [H, W], 0 for none; cached."""
        if self.table.parts is None:
            return np.zeros((posed.camera.height, posed.camera.width), np.uint16)
        return self._map(posed, self.table.parts)

    def mask(self, posed: PosedCamera, thing_ids: Sequence[int]) -> NDArray[np.bool_]:
        """Mask of things, parts or groups in a view, bool [H, W]."""
        ids = self._members(thing_ids)
        inside = np.isin(self.map(posed), ids)
        if any(part.id in ids for part in self.present_parts):
            inside |= np.isin(self.part_map(posed), ids)
        return np.asarray(inside)

    def rows(self, thing_ids: Sequence[int]) -> NDArray[np.bool_]:
        """Selects Gaussians of things, parts or groups, bool [G]."""
        ids = self._members(thing_ids)
        inside = np.isin(self.owner, ids)
        return np.asarray(inside | np.isin(self.part_owner, ids) if self.present_parts else inside)

    @cached_property
    def views_of_things(self) -> dict[int, tuple[str, ...]]:
        """Cache of `thing_detections`: cameras that see each thing; survives renaming."""
        return {}

    @cached_property
    def _maps(self) -> KeptMaps:
        return KeptMaps()

    def _map(self, posed: PosedCamera, of: Things | Parts) -> ThingMap:
        key = (posed.camera, posed.world_from_camera.tobytes(), isinstance(of, Parts))
        return self._maps.get(key, lambda: self._draw(posed, of))

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
        """Extents of each visible thing and part, by id."""
        parts = extents_of(self.scene, self.part_owner) if self.present_parts else {}
        return {**extents_of(self.scene, self.owner), **parts}

    def best_views(self, thing_ids: Sequence[int]) -> Mapping[int, tuple[str, ...]]:
        """Names of at most five best cameras for each thing or part, see `visibility`."""
        missing = {thing_id for thing_id in thing_ids if thing_id not in self._best_views}
        if missing:
            gaussians, solid = self.scene.gaussians, solid_rows(self.scene.gaussians)
            owners = (self.owner, self.part_owner) if self.present_parts else (self.owner,)
            groups = {each: rows for owner in owners for each, rows in grouped_rows(owner, solid) if each in missing}
            views = best_views(self.scene, [*groups.values()], masses(gaussians.log_scales, gaussians.logit_opacities))
            self._best_views.update(zip(groups, views, strict=True))
        return self._best_views

    @cached_property
    def _best_views(self) -> dict[int, tuple[str, ...]]:
        return {}

    def _described(self, thing: Thing, counts: NDArray[np.int64], parts: tuple[int, ...]) -> SceneThing:
        extent = self.extents.get(thing.id)
        return SceneThing(
            id=thing.id,
            name=thing.name,
            source=thing.source,
            probability=thing.probability,
            suggestions=listed_suggestions(thing, self.names.trust),
            kind="part" if thing.parent else "surface" if thing.surface else "thing",
            surface=thing.surface,
            consensus=thing.consensus,
            gaussian_count=int(counts[thing.id]),
            box=None if extent is None else extent.box,
            meters=self.scene.scale == "METRIC",
            parent=thing.parent,
            parts=parts,
            centroid=None if extent is None else extent.centroid,
            guess=thing.guessed,
            groups=tuple(group.id for group in self.groups.values() if thing.id in group.members),
            reads=thing.reads,
            last_seen=self.history.last_seen(thing.parent or thing.id),
            missing_since=self.history.missing_since(thing.parent or thing.id),
            seen_in=self.history.seen_in(thing.parent or thing.id),
            label_id=self.scene.dictionary.id_of(thing.name) or 0 if thing.name else 0,
        )


def listed_suggestions(thing: Thing, trust: Trust) -> tuple[NameSuggestion, ...]:
    """Suggested names of a thing as listed in answers, most probable first."""
    return tuple(_told(each) for each in merged_suggestions(thing, trust))


def _told(name: MergedName) -> NameSuggestion:
    said_by = tuple(SuggestionSource(each.source or OWN_SOURCE, each.model, each.probability) for each in name.told)
    return NameSuggestion(name.name, name.probability, "", name.aliases, said_by)


def _same_members(one: Things, other: Things) -> bool:
    parts = [None if things.parts is None else things.parts.membership for things in (one, other)]
    return one.membership is other.membership and parts[0] is parts[1]
