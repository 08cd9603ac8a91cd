"""Job requests to train finished scenes further: checked and queued here, and done by a worker."""

from __future__ import annotations

from collections.abc import Sequence

from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.application.answering.open_scenes import OpenScenes
from fastsplat.service.application.base.validate import check_request_id, check_seconds, check_texts
from fastsplat.service.application.editing.version_rows import version_of
from fastsplat.service.application.jobs.running_jobs import RunningJobs
from fastsplat.service.application.jobs.scene_orders import place_order
from fastsplat.service.capture.photos.scene_photos import photo_folder
from fastsplat.service.joined_photos import joining_photos
from fastsplat.service.planning.presets import preset_name
from fastsplat.service.scene.changes import CHANGING, changed_views
from fastsplat.service.settings import Settings
from fastsplat.service.store.ordered_jobs import order_job
from fastsplat.service.store.records import NewJob, SceneRecord
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import InvalidInputError, NotReadyError
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.operations import Operation
from fastsplat_contract.scenes import SceneVersion
from fastsplat_contract.train_more_messages import TrainMoreIn


class FurtherTraining:
    """Orders of one project to train its scenes further."""

    def __init__(self, store: Store, settings: Settings, scenes: OpenScenes, quotas: Quotas, project: str) -> None:
        self._store, self._settings, self._scenes = store, settings, scenes
        self._quotas, self._project = quotas, project
        self._jobs = RunningJobs(store, settings)

    def order(self, scene_id: str, request: TrainMoreIn) -> Operation:
        """Queue a job that trains a finished scene further, from its current version. Durable once this returns.

        Raises:
            NotReadyError: it is not ready, no photos are kept with it or with an observation, or its current version
                shows what the photos do not, as something was moved; the error names the version that can be trained.
            NotFoundError: there is no such scene, or no such observation in its current version.
            InvalidInputError: as `joining_photos`; seconds and steps both, more steps than the settings allow, seconds
                that are none, or no such preset.
            LimitExceededError: more seconds than the settings allow.
            ConflictError: as `place_order`.
            QuotaError: as many of the project's jobs wait or run as may.
        """
        version = self._scenes.finished(scene_id)
        job = _job_of(scene_id, version, request, self._project, self._settings)

        def check() -> None:
            scene = self._store.scenes.scene(scene_id)
            versions = [version_of(record) for record in self._store.versions.of(scene)]
            if not any(photo_folder(self._scenes.folder(scene_id, version)).glob("*.jpg")):
                raise _no_photos()
            _check_unchanged(scene, version, versions)
            if request.observations:
                check_texts(request.observations, "observations")
                folder = self._scenes.folder(scene_id, version)
                self._scenes.reading(
                    scene_id, version, lambda index, _: joining_photos(index.scene, folder, request.observations)
                )

        return self._jobs.operation(place_order(job, self._store, self._quotas, check))


def _no_photos() -> NotReadyError:
    return NotReadyError(
        "no photos are kept with this scene, so there is nothing to train it on",
        field="scene",
        hint="Photos are kept with scenes that are made of photos while FASTSPLAT_PHOTOS__KEEP is on. Post the photos "
        "again, with a longer time.",
    )


def _check_unchanged(scene: SceneRecord, version: str, versions: Sequence[SceneVersion]) -> None:
    """Raise unless a version shows what its photos show.

    Args:
        scene: as its current version has it.
        version: its current one.
        versions: all of it.

    Raises:
        NotReadyError: something was recolored, removed, moved, duplicated or inserted; the error names the newest
            version of before.
    """
    known, line = {each.version: each for each in versions}, []
    name = version
    while name in known and name not in line:
        line.append(name)
        name = known[name].parent
    line.reverse()
    actions, last = list(changed_views(scene.quality)), ""
    for name in line:
        own = [edit.action for edit in known[name].edits if edit.action in CHANGING]
        actions += [action for action in own if action not in actions]
        if own:
            break
        last = name
    if not actions:
        return
    if last == version:  # what changed it was made of versions that are not kept any more
        last = line[0]
    raise NotReadyError(
        f"version {version} shows what its photos do not ({', '.join(actions)}), and training would undo that",
        field="version",
        hint=f"Restore version {last}, train that one further, then edit it again.",
    )


def _job_of(scene_id: str, version: str, request: TrainMoreIn, project: str, settings: Settings) -> NewJob:
    """The job that trains a scene further, beginning with `version`."""
    check_request_id(request.request_id)
    if request.seconds is not None and request.steps is not None:
        raise InvalidInputError(
            "seconds and steps at once", field="steps", hint="Send one of them, or neither for the preset's time."
        )
    limit = settings.training.iterations
    if request.steps is not None and not 1 <= request.steps <= limit:
        raise InvalidInputError(
            f"{request.steps} steps",
            field="steps",
            limit=f"1 to {limit} (FASTSPLAT_TRAINING__ITERATIONS)",
            hint="Train it further several times.",
        )
    if request.seconds is not None:
        check_seconds(request.seconds, "seconds")
    if request.preset is not None:
        preset_name(request.preset)
    order = to_plain(TrainMoreIn(request.seconds, request.steps, request.preset, request.observations))
    return order_job("train_more", scene_id, request.request_id, order, project, version=version)
