"""Sightings of objects in the capture and in later observations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime

from fastsplat.service.scene.artefact.frames import frame_of
from fastsplat.service.scene.artefact.observations import in_frame
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.photos.localization import SceneChange
from fastsplat_contract.photos.observations import Observation


@dataclass(frozen=True)
class Sighting:
    """An object's state in one observation, or in the capture."""

    at: datetime  # when its photos were taken
    observation_id: str  # of the observation; "" of the capture
    change: SceneChange | None = None  # what has become of the object; None: it is where it was when the scene was made

    @property
    def missing(self) -> bool:
        """True if the object was looked for and not found."""
        return self.change is not None and self.change.kind in ("gone", "changed")


@dataclass(frozen=True)
class SceneHistory:
    """History of a scene's objects."""

    made_at: datetime | None  # time of the capture's newest photo; None if unknown
    observations: tuple[Observation, ...]  # oldest photos first, in the version's frame; sentences as stored
    looked_at_again: Mapping[int, tuple[Sighting, ...]]  # by object id, oldest first, with the capture's

    @property
    def later(self) -> tuple[Observation, ...]:
        """Observations of photos taken after the capture's."""
        return tuple(
            observation
            for observation in self.observations
            if self.made_at is None or observation.seen_at > self.made_at
        )

    def sightings(self, object_id: int) -> tuple[Sighting, ...]:
        """Sightings of an object, oldest first; empty if undated and never looked at again."""
        return self.looked_at_again.get(object_id, _by_capture(self.made_at))

    def last_seen(self, object_id: int) -> datetime | None:
        """Time of the last photo of an object; None if unknown."""
        seen = [sighting.at for sighting in self.sightings(object_id) if not sighting.missing]
        return seen[-1] if seen else None

    def missing_since(self, object_id: int) -> datetime | None:
        """Start of the current run of failed searches; None if not missing."""
        since: datetime | None = None
        for sighting in self.sightings(object_id):
            since = (since or sighting.at) if sighting.missing else None
        return since

    def seen_in(self, object_id: int) -> str:
        """Id of an object's last observation; "" for the capture."""
        sightings = self.sightings(object_id)
        return sightings[-1].observation_id if sightings else ""


def scene_history(scene: Scene) -> SceneHistory:
    """Builds the history of a version's objects."""
    frame = frame_of(scene)
    placed = [
        replace(in_frame(observation, frame), meters=scene.scale == "METRIC") for observation in scene.observations
    ]
    observations = tuple(sorted(placed, key=lambda observation: observation.seen_at))
    made_at = scene.facts.newest_photo_at
    found: dict[int, list[Sighting]] = {}
    for visit in observations:
        changed = {change.object_id: change for change in visit.changes if change.object_id}
        for object_id in {*visit.looked_at, *changed}:
            found.setdefault(object_id, []).append(Sighting(visit.seen_at, visit.id, changed.get(object_id)))
    ordered = {
        object_id: tuple(sorted((*sightings, *_by_capture(made_at)), key=lambda sighting: sighting.at))
        for object_id, sightings in found.items()
    }
    return SceneHistory(made_at, observations, ordered)


def _by_capture(made_at: datetime | None) -> tuple[Sighting, ...]:
    return () if made_at is None else (Sighting(made_at, ""),)
