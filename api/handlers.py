"""Handlers of plain request-and-answer calls, shared by REST and gRPC.

Each protocol implements uploads, streams, waiting and ranged files itself.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from fastsplat.api.access.caller import caller_id, caller_role
from fastsplat.api.examples import (
    admin_examples,
    change_examples,
    job_watching_examples,
    localize_examples,
    scene_examples,
)
from fastsplat.api.examples.change_examples import Bodies
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract import calls
from fastsplat_contract.call import Call
from fastsplat_contract.messages.projects import JobLog, ProjectList
from fastsplat_contract.messages.scenes import Edit, VersionList

Q = TypeVar("Q")
A = TypeVar("A")
R = TypeVar("R")


@dataclass(frozen=True)
class Handler(Generic[Q, A]):
    """The handler of one call."""

    call: Call[Q, A]
    ask: Callable[[SceneService, Q], A]  # runs on a thread, with the service of the caller's project
    computes: bool = False  # has the shorter deadline of `Threads.answer`
    renders: bool = False  # takes long, and therefore runs in the background
    example: A | None = None  # for OpenAPI, once per answer type
    bodies: Bodies = field(default_factory=dict)  # for OpenAPI, once per body type

    def run(self, threads: Threads, function: Callable[[], R]) -> Awaitable[R]:
        """Runs a function on a thread, with the deadline and priority of this call."""
        return threads.answer(function, self.renders) if self.computes else threads.call(function)


HANDLERS: Mapping[str, Handler[Any, Any]] = {
    handler.call.rpc: handler
    for handler in (
        Handler(calls.OPEN_SAMPLE, lambda service, asked: service.open_sample()),
        Handler(
            calls.GET_SCENE, lambda service, asked: service.get_scene(asked.scene_id), example=scene_examples.SCENE
        ),
        Handler(
            calls.LIST_SCENES,
            lambda service, asked: service.list_scenes(asked.page_size, asked.page_token),
            example=scene_examples.SCENES,
        ),
        Handler(
            calls.UPDATE_SCENE,
            lambda service, asked: service.update_scene(asked.scene_id, asked),
            bodies=scene_examples.NAMES,
        ),
        Handler(calls.DELETE_SCENE, lambda service, asked: service.delete_scene(asked.scene_id)),
        Handler(
            calls.LIST_PHOTO_VERDICTS,
            lambda service, asked: service.list_photo_verdicts(asked.scene_id, asked.page_size, asked.page_token),
            example=scene_examples.PHOTO_VERDICTS,
        ),
        Handler(
            calls.LIST_LABELS,
            lambda service, asked: service.list_labels(asked.scene_id, asked.page_size, asked.page_token),
            example=scene_examples.LABELS,
        ),
        Handler(
            calls.LIST_OBJECTS,
            lambda service, asked: service.answers.list_objects(
                asked.scene_id, asked.version, asked.page_size, asked.page_token, asked.parts
            ),
            computes=True,
            example=scene_examples.OBJECTS,
        ),
        Handler(
            calls.PICK_OBJECT,
            lambda service, asked: service.answers.pick(asked),
            computes=True,
            example=scene_examples.PICKED,
            bodies=scene_examples.PLACES,
        ),
        Handler(
            calls.MEASURE_SCENE,
            lambda service, asked: service.answers.measure(asked),
            computes=True,
            example=change_examples.MEASUREMENT,
            bodies=change_examples.MEASURED,
        ),
        Handler(
            calls.EDIT_SCENE,
            lambda service, asked: service.versions.edit(
                asked.scene_id, asked.edits, asked.request_id, asked.version, caller_id()
            ),
            example=scene_examples.VERSION,
            bodies=scene_examples.EDITS,
        ),
        Handler(
            calls.PREVIEW_EDIT,
            lambda service, asked: service.versions.preview(asked.scene_id, asked.edits, asked.version),
            computes=True,
            renders=True,
            example=change_examples.EDIT_PREVIEW,
            bodies=change_examples.PREVIEWED,
        ),
        Handler(
            calls.SUGGEST_NAMES,
            lambda service, asked: service.versions.edit(
                asked.scene_id, (Edit("suggest", suggestions=asked.suggestions),), asked.request_id, author=caller_id()
            ),
            bodies=change_examples.SUGGESTED,
        ),
        Handler(
            calls.ASK_CAPTIONER,
            lambda service, asked: service.captioner.order(asked.scene_id, asked.request_id),
            bodies=change_examples.CAPTIONER_ASKED,
        ),
        Handler(
            calls.AGREE_TO_CAPTIONER,
            lambda service, asked: service.captioner.agree(asked.host),
            example=admin_examples.CAPTIONER,
            bodies=admin_examples.AGREEMENTS,
        ),
        Handler(
            calls.UNDO_EDIT,
            lambda service, asked: service.versions.undo(asked.scene_id, asked.version),
            bodies=scene_examples.UNDONE,
        ),
        Handler(
            calls.REDO_EDIT,
            lambda service, asked: service.versions.redo(asked.scene_id, asked.version),
            bodies=change_examples.REDONE,
        ),
        Handler(
            calls.RESTORE_VERSION,
            lambda service, asked: service.versions.restore(asked.scene_id, asked.version, asked.expected),
            bodies=change_examples.RESTORED,
        ),
        Handler(
            calls.LIST_VERSIONS,
            lambda service, asked: VersionList(service.versions.all(asked.scene_id)),
            example=scene_examples.VERSIONS,
        ),
        Handler(
            calls.LOOK_AGAIN,
            lambda service, asked: service.look_again(asked.scene_id, asked),
            bodies=change_examples.SOUGHT,
        ),
        Handler(
            calls.GET_OPERATION,
            lambda service, asked: service.get_operation(asked.operation_id),
            example=scene_examples.OPERATION,
        ),
        Handler(
            calls.LIST_OPERATIONS,
            lambda service, asked: service.list_operations(asked.page_size, asked.page_token, asked.state),
            example=scene_examples.OPERATIONS,
        ),
        Handler(calls.CANCEL_OPERATION, lambda service, asked: service.cancel_operation(asked.operation_id)),
        Handler(
            calls.RETRY_OPERATION,
            lambda service, asked: service.retry_operation(asked.operation_id, asked.exclude),
            bodies=change_examples.RETRIED,
        ),
        Handler(calls.FINISH_OPERATION, lambda service, asked: service.jobs.finish(asked.operation_id)),
        Handler(
            calls.GET_PREVIEW,
            lambda service, asked: service.jobs.preview(asked.operation_id),
            example=job_watching_examples.PREVIEW,
        ),
        Handler(
            calls.GET_JOB_LOG,
            lambda service, asked: service.jobs.log(asked.operation_id),
            example=JobLog("loading 60 images\n"),
        ),
        Handler(
            calls.GET_PLACED_CAMERAS,
            lambda service, asked: service.jobs.placed_cameras(asked.operation_id),
            example=job_watching_examples.PLACED,
        ),
        Handler(calls.RENDER_VIEW, lambda service, asked: service.answers.picture(asked), computes=True, renders=True),
        Handler(calls.EXPORT_SCENE, lambda service, asked: service.exports.file(asked), computes=True, renders=True),
        Handler(
            calls.LIST_PHOTOS,
            lambda service, asked: service.photos.all(asked.scene_id, asked.version, asked.page_size, asked.page_token),
            example=scene_examples.PHOTOS,
        ),
        Handler(
            calls.LIST_NEXT_PHOTOS,
            lambda service, asked: service.photos.next_photos(asked.scene_id, asked.version),
            computes=True,
            renders=True,
            example=change_examples.NEXT_PHOTOS,
        ),
        Handler(
            calls.GET_GOAL,
            lambda service, asked: service.exports.goal(
                asked.scene_id, asked.object_id, asked.robot_radius, asked.version
            ),
            computes=True,
            example=change_examples.GOAL,
        ),
        Handler(
            calls.LIST_DETECTIONS,
            lambda service, asked: service.detections.all(
                asked.scene_id, asked.version, asked.page_size, asked.page_token
            ),
            computes=True,
            example=change_examples.DETECTIONS,
        ),
        Handler(
            calls.LOCALIZE,
            lambda service, asked: service.localizing.localize(asked),
            computes=True,
            renders=True,
            example=localize_examples.LOCALIZATION,
        ),
        Handler(
            calls.OBSERVE_SCENE,
            lambda service, asked: service.observations.observe(asked, caller_id()),
            example=localize_examples.OBSERVATION,
        ),
        Handler(
            calls.LIST_OBSERVATIONS,
            lambda service, asked: service.observations.all(
                asked.scene_id, asked.version, asked.page_size, asked.page_token
            ),
            computes=True,
            example=localize_examples.OBSERVATIONS,
        ),
        Handler(
            calls.GET_OBSERVATION,
            lambda service, asked: service.observations.get(asked.scene_id, asked.observation_id, asked.version),
            computes=True,
        ),
        Handler(
            calls.LIST_BEST_VIEWS,
            lambda service, asked: service.photos.best_views(
                asked.scene_id, asked.object_ids, asked.text, asked.max_views, asked.version
            ),
            computes=True,
            renders=True,
            example=scene_examples.BEST_VIEWS,
        ),
        Handler(
            calls.GET_CONTACT_SHEET,
            lambda service, asked: service.sheets.page(
                asked.scene_id, asked.version, asked.page_size, asked.page_token
            ),
            computes=True,
            renders=True,
            example=scene_examples.CONTACT_SHEET,
        ),
        Handler(
            calls.CREATE_KEY,
            lambda service, asked: service.keys.create(caller_role(), asked),
            example=admin_examples.NEW_KEY,
            bodies=admin_examples.NEW_KEYS,
        ),
        Handler(
            calls.CREATE_UPLOAD_KEY,
            lambda service, asked: service.keys.create_for_upload(asked),
            bodies=admin_examples.UPLOAD_KEYS,
        ),
        Handler(
            calls.LIST_KEYS,
            lambda service, asked: service.keys.list(caller_role(), asked.page_size, asked.page_token, asked.scene_id),
            example=admin_examples.KEYS,
        ),
        Handler(
            calls.REVOKE_KEY,
            lambda service, asked: service.keys.revoke(caller_role(), asked.key_id),
            example=admin_examples.KEY,
        ),
        Handler(
            calls.ESTIMATE_JOB,
            lambda service, asked: service.estimates.estimate(asked),
            computes=True,
            example=job_watching_examples.ESTIMATE,
        ),
        Handler(
            calls.GET_SERVER_STATUS,
            lambda service, asked: service.status(caller_role(), caller_id()),
            example=admin_examples.STATUS,
        ),
        Handler(
            calls.LIST_PROJECTS,
            lambda service, asked: service.admin.projects.all(),
            example=ProjectList((admin_examples.PROJECT,)),
        ),
        Handler(
            calls.CREATE_PROJECT,
            lambda service, asked: service.admin.projects.create(asked.name),
            example=admin_examples.PROJECT,
            bodies=admin_examples.PROJECTS,
        ),
        Handler(
            calls.LIST_KNOWN_NAMES,
            lambda service, asked: service.known_names.list(asked.page_size, asked.page_token),
            example=admin_examples.KNOWN_NAMES,
        ),
        Handler(calls.DELETE_KNOWN_NAME, lambda service, asked: service.known_names.forget(asked.name_id)),
    )
}
"""Handlers by RPC name."""
