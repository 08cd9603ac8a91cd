"""Observations: photos of another day, compared with a scene and stored as a version."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.application.answering.localizing import Localizing
from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.memory import edit_bytes
from fastsplat.service.application.base.paging import page_of
from fastsplat.service.application.base.validate import check_page_size, check_request_id, check_texts
from fastsplat.service.application.editing.version_files import new_version_name
from fastsplat.service.application.editing.versions import VersionOrder, Versions
from fastsplat.service.capture.photos.scene_photos import write_observed_photos
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.language.sentences.change_sentences import changes_sentence, in_words
from fastsplat.service.scene.artefact.frames import frame_of
from fastsplat.service.scene.artefact.observations import in_frame
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.errors import ConflictError, InvalidInputError, LimitExceededError, NotFoundError
from fastsplat_contract.messages.scenes import Edit
from fastsplat_contract.photos.localization import LocalizeRequest
from fastsplat_contract.photos.observations import (
    Observation,
    ObservationList,
    ObservedPhoto,
    ObserveRequest,
    SeenAtSource,
)

if TYPE_CHECKING:  # torch loads when it is used
    from fastsplat.service.application.answering.localized_photos import LocalizedPictures
    from fastsplat.service.query.scene_index import SceneIndex

MAX_OBSERVATIONS = 100
"""Limit per version; each later version links every photo of them."""
_FEWEST_PHOTOS = 2
"""Least number of localized photos: an event is what two photos agree on."""
_TRIES = 3
_AHEAD = timedelta(days=1)
"""Tolerated lead of camera clocks."""


class Observations:
    """Observations of scenes. Thread-safe."""

    def __init__(self, context: ProjectContext, localizing: Localizing, versions: Versions) -> None:
        self._context = context
        self._localizing = localizing
        self._versions = versions

    def observe(self, request: ObserveRequest, author: str = "") -> Observation:
        """Compares photos of another day with a scene, stored as its current version. Durable.

        `author` is the id of the caller's key, "" for none. Errors as `Localizing.localize`, and:

        Raises:
            InvalidInputError: fewer than two localized photos; a time without a time zone, or in the future.
            LimitExceededError: too many observations.
            ConflictError: the request id was used for other photos, or its observation was undone.
        """
        check_request_id(request.request_id)
        now = datetime.now(UTC)
        _check_time(request.seen_at, now)
        digest = _digest(request)
        for remaining in reversed(range(_TRIES)):
            current = self._context.scenes.finished(request.scene_id)
            earlier = self._context.store.versions.made_by(request.scene_id, request.request_id, digest)
            if earlier is not None:
                return self.get(request.scene_id, self._versions.in_force(earlier).version)
            localize_request = LocalizeRequest(
                scene_id=request.scene_id,
                photos=request.photos,
                focals=request.focals,
                poses=request.poses,
                version=current,
            )
            index, located = self._localizing.locate(localize_request)
            # No photos where the scene keeps none, or had people redacted, for whom these were not searched.
            withheld = index.scene.facts.withheld
            keep = self._context.settings.photos.keep == "on" and (withheld is None or withheld.privacy is None)
            observation, pictures = _observation(request, located, now, keep)
            check_cancelled()
            try:
                self._publish(request, observation, pictures, index, current, digest, author)
            except ConflictError:  # a concurrent edit: compare with its result
                if not remaining:
                    raise
                continue
            return self.get(request.scene_id, observation.id)
        raise AssertionError

    def all(self, scene_id: str, version: str = "", page_size: int = 0, page_token: str = "") -> ObservationList:
        """Observations of a version, latest first, paged as `SceneService.list_scenes`."""
        size = check_page_size(page_size, self._context.settings.store)
        check_texts(version, "version")
        index, name = self._context.scenes.open(scene_id, version)
        newest = _observations(index, scene_id)[::-1]
        page, token = page_of(newest, size, page_token, f"observations {scene_id} {name}")
        return ObservationList(tuple(page), token, name)

    def get(self, scene_id: str, observation_id: str, version: str = "") -> Observation:
        """One observation of a version; raises `NotFoundError` if it is unknown or was undone."""
        check_texts((version, observation_id), "observation_id")
        observations = _observations(self._context.scenes.open(scene_id, version)[0], scene_id)
        for observation in observations:
            if observation.id == observation_id:
                return observation
        raise NotFoundError(
            f"no observation {observation_id[:80]!r} in this version of the scene",
            field="observation_id",
            hint="List the scene's observations; one that was undone is in the version that it made.",
        )

    def _publish(
        self,
        request: ObserveRequest,
        observation: Observation,
        pictures: Sequence[NDArray[np.uint8]],
        index: SceneIndex,
        parent: str,
        digest: str,
        author: str,
    ) -> None:
        if len(index.scene.observations) >= MAX_OBSERVATIONS:
            raise LimitExceededError(
                "one observation more than a scene may have",
                field="scene_id",
                limit=f"{MAX_OBSERVATIONS} observations",
                hint="Undo some, or train a new scene of newer photos.",
            )
        stored = in_frame(observation, frame_of(index.scene).inverse())
        edit = Edit("observe")
        rows = [to_plain(edit)]
        order = VersionOrder(request.scene_id, (edit,), rows, digest, request.request_id, "", author)

        def add_photos(folder: Path) -> None:
            write_observed_photos(pictures, folder, observation.id, self._context.settings.photos)

        with self._context.memory.reserve(edit_bytes(index.scene, ()), "photos"):
            after = index.after(replace(index.scene, observations=(*index.scene.observations, stored)))
            self._versions.publish(order, parent, index, after, observation.id, add_photos)


def _observations(index: SceneIndex, scene_id: str) -> tuple[Observation, ...]:
    """Observations of a version, oldest first, with this scene's id even in a copy."""
    names = {obj.id: obj.name for obj in index.objects.table.table}
    return tuple(
        replace(in_words(observation, names), scene_id=scene_id) for observation in index.objects.history.observations
    )


def _observation(
    request: ObserveRequest, located: LocalizedPictures, now: datetime, keep: bool
) -> tuple[Observation, Sequence[NDArray[np.uint8]]]:
    """Builds the observation, in the version's frame, and the photos to keep."""
    answer, observation_id = located.answer, new_version_name()
    there = [number for number, photo in enumerate(answer.photos) if photo.camera is not None]
    left_out = [
        f"photos[{number}]: {photo.explanation}" for number, photo in enumerate(answer.photos) if photo.camera is None
    ]
    if len(there) < _FEWEST_PHOTOS:
        raise InvalidInputError(
            f"{len(there)} of {len(answer.photos)} photos found their place in the scene",
            field="photos",
            limit=f"{_FEWEST_PHOTOS} photos or more, from several places",
            hint=left_out[0].partition(": ")[2] if left_out else "Send more photos of the same place.",
        )
    row = {number: place for place, number in enumerate(there)}
    photos = tuple(
        ObservedPhoto(f"{observation_id}/{place}" if keep else "", camera, answer.photos[number].differences)
        for place, number in enumerate(there)
        if (camera := answer.photos[number].camera) is not None
    )
    changes = tuple(change._replace(photos=tuple(row[number] for number in change.photos)) for change in answer.changes)
    taken = [seconds for number in there if (seconds := located.taken_at[number]) is not None]
    seen_at, source = _time_of(request.seen_at, taken, now)
    observation = Observation(
        scene_id=request.scene_id,
        id=observation_id,
        seen_at=seen_at,
        seen_at_source=source,
        photos=photos,
        left_out=tuple(left_out),
        changes=changes,
        looked_at=answer.looked_at,
        meters=answer.meters,
        sentence=changes_sentence(changes, len(answer.looked_at)),
    )
    pictures = [picture for number in there if (picture := located.pictures[number]) is not None]
    return observation, pictures if keep else ()


def _time_of(said: datetime | None, taken: Sequence[float], now: datetime) -> tuple[datetime, SeenAtSource]:
    """Capture time: as requested, else from metadata unless the camera's clock is ahead."""
    if said is not None:
        return said.astimezone(UTC), "given"
    if taken and (newest := datetime.fromtimestamp(max(taken), UTC)) <= now + _AHEAD:
        return newest, "metadata"
    return now, "received"


def _check_time(seen_at: datetime | None, now: datetime) -> None:
    if seen_at is None:
        return
    if seen_at.tzinfo is None:
        raise InvalidInputError(
            "a time without its time zone", field="seen_at", hint="Send e.g. 2026-11-23T18:00:00+01:00."
        )
    if seen_at > now + _AHEAD:
        raise InvalidInputError(
            "photos that are still to be taken", field="seen_at", limit=f"{now.isoformat(timespec='seconds')}"
        )


def _digest(request: ObserveRequest) -> str:
    said = {name: value for name, value in to_plain(request).items() if name not in ("photos", "request_id")}
    photos = [hashlib.sha256(photo).hexdigest() for photo in request.photos]
    return hashlib.sha256(json.dumps([said, photos], sort_keys=True).encode()).hexdigest()
