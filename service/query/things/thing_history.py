"""Where things were seen, and from when they are missing: what a scene's photos and its observations say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime

from fastsplat.service.scene.artefact.capture_times import newest_photo_at
from fastsplat.service.scene.artefact.frames import frame_of
from fastsplat.service.scene.artefact.observations import in_frame
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.photos.localization import SceneChange
from fastsplat_contract.photos.observations import Observation


@dataclass(frozen=True)
class Sighting:
    """What one observation says of a thing, or the capture, which shows it where it is."""

    at: datetime  # when its photos were taken
    observation_id: str  # of the observation; "" of the capture
    change: SceneChange | None = None  # what has become of the thing; None: it is where it was when the scene was made

    @property
    def missing(self) -> bool:
        """Whether the thing was looked for and not found anywhere."""
        return self.change is not None and self.change.kind in ("gone", "changed")


@dataclass(frozen=True)
class SceneHistory:
    """What is known of the things of a scene over time.

    Attributes:
        made_at: when the newest photo of the scene's capture was taken; None where the photos do not say it.
        observations: the oldest photos first, in the frame of the scene's version; its sentences are of the day on
            which they came.
        looked_at_again: what was seen of each thing that was, by its id, the oldest first, the capture's own among it.
    """

    made_at: datetime | None
    observations: tuple[Observation, ...]
    looked_at_again: Mapping[int, tuple[Sighting, ...]]

    @property
    def later(self) -> tuple[Observation, ...]:
        """The observations of photos taken after those of the capture: only they tell what it does not."""
        return tuple(each for each in self.observations if self.made_at is None or each.seen_at > self.made_at)

    def sightings(self, thing_id: int) -> tuple[Sighting, ...]:
        """What was seen of a thing, the oldest first; nothing where the capture's photos do not say when they were
        taken and nobody looked again."""
        return self.looked_at_again.get(thing_id, _by_capture(self.made_at))

    def last_seen(self, thing_id: int) -> datetime | None:
        """When a photo last showed a thing; None where that is unknown."""
        seen = [each.at for each in self.sightings(thing_id) if not each.missing]
        return seen[-1] if seen else None

    def missing_since(self, thing_id: int) -> datetime | None:
        """When a thing was first looked for in vain, of the last times that it was looked for; None for one that was
        not, or that was found again."""
        since: datetime | None = None
        for each in self.sightings(thing_id):
            since = (since or each.at) if each.missing else None
        return since

    def seen_in(self, thing_id: int) -> str:
        """The id of the last observation that says something of a thing; "" where that is the capture."""
        own = self.sightings(thing_id)
        return own[-1].observation_id if own else ""


def scene_history(scene: Scene) -> SceneHistory:
    """The history of a version's things."""
    frame = frame_of(scene)
    placed = [replace(in_frame(each, frame), meters=scene.scale == "METRIC") for each in scene.observations]
    observations = tuple(sorted(placed, key=lambda each: each.seen_at))
    made_at = newest_photo_at(scene.quality)
    found: dict[int, list[Sighting]] = {}
    for each in observations:
        changed = {change.thing_id: change for change in each.changes if change.thing_id}
        for thing_id in {*each.looked_at, *changed}:
            found.setdefault(thing_id, []).append(Sighting(each.seen_at, each.id, changed.get(thing_id)))
    ordered = {
        thing_id: tuple(sorted((*own, *_by_capture(made_at)), key=lambda each: each.at))
        for thing_id, own in found.items()
    }
    return SceneHistory(made_at, observations, ordered)


def _by_capture(made_at: datetime | None) -> tuple[Sighting, ...]:
    return () if made_at is None else (Sighting(made_at, ""),)
