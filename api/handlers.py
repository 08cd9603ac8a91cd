"""Handlers of plain request-and-answer calls, shared by REST and gRPC.

Each protocol implements uploads, streams, waiting and ranged files itself.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from fastsplat.api.access.caller import caller_id, caller_role
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract import calls
from fastsplat_contract.call import Call
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
    renders: bool = False  # the same, takes long, and therefore runs in the background

    def run(self, threads: Threads, function: Callable[[], R]) -> Awaitable[R]:
        """Runs a function on a thread, with the deadline and priority of this call."""
        return threads.answer(function, self.renders) if self.computes or self.renders else threads.call(function)


HANDLERS: Mapping[str, Handler[Any, Any]] = {
    handler.call.rpc: handler
    for handler in (
        Handler(calls.OPEN_SAMPLE, lambda service, req: service.open_sample()),
        Handler(calls.GET_SCENE, lambda service, req: service.get_scene(req.scene_id)),
        Handler(calls.LIST_SCENES, lambda service, req: service.list_scenes(**vars(req))),
        Handler(calls.UPDATE_SCENE, lambda service, req: service.update_scene(req.scene_id, req)),
        Handler(calls.DELETE_SCENE, lambda service, req: service.delete_scene(req.scene_id)),
        Handler(calls.LIST_PHOTO_VERDICTS, lambda service, req: service.list_photo_verdicts(**vars(req))),
        Handler(calls.LIST_LABELS, lambda service, req: service.list_labels(**vars(req))),
        Handler(calls.LIST_OBJECTS, lambda service, req: service.answers.list_objects(**vars(req)), computes=True),
        Handler(calls.PICK_OBJECT, lambda service, req: service.answers.pick(req), computes=True),
        Handler(calls.MEASURE_SCENE, lambda service, req: service.answers.measure(req), computes=True),
        Handler(
            calls.EDIT_SCENE,
            lambda service, req: service.versions.edit(
                req.scene_id, req.edits, req.request_id, req.version, caller_id()
            ),
        ),
        Handler(calls.PREVIEW_EDIT, lambda service, req: service.versions.preview(**vars(req)), renders=True),
        Handler(
            calls.SUGGEST_NAMES,
            lambda service, req: service.versions.edit(
                req.scene_id, (Edit("suggest", suggestions=req.suggestions),), req.request_id, author=caller_id()
            ),
        ),
        Handler(calls.ASK_CAPTIONER, lambda service, req: service.captioner.order(**vars(req))),
        Handler(calls.AGREE_TO_CAPTIONER, lambda service, req: service.captioner.agree(req.host)),
        Handler(calls.UNDO_EDIT, lambda service, req: service.versions.undo(**vars(req))),
        Handler(calls.REDO_EDIT, lambda service, req: service.versions.redo(**vars(req))),
        Handler(calls.RESTORE_VERSION, lambda service, req: service.versions.restore(**vars(req))),
        Handler(calls.LIST_VERSIONS, lambda service, req: VersionList(service.versions.all(req.scene_id))),
        Handler(calls.LOOK_AGAIN, lambda service, req: service.look_again(req.scene_id, req)),
        Handler(calls.GET_OPERATION, lambda service, req: service.get_operation(req.operation_id)),
        Handler(calls.LIST_OPERATIONS, lambda service, req: service.list_operations(**vars(req))),
        Handler(calls.CANCEL_OPERATION, lambda service, req: service.cancel_operation(req.operation_id)),
        Handler(calls.RETRY_OPERATION, lambda service, req: service.retry_operation(**vars(req))),
        Handler(calls.FINISH_OPERATION, lambda service, req: service.jobs.finish(req.operation_id)),
        Handler(calls.GET_PREVIEW, lambda service, req: service.jobs.preview(req.operation_id)),
        Handler(calls.GET_JOB_LOG, lambda service, req: service.jobs.log(req.operation_id)),
        Handler(calls.GET_PLACED_CAMERAS, lambda service, req: service.jobs.placed_cameras(req.operation_id)),
        Handler(calls.RENDER_VIEW, lambda service, req: service.answers.picture(req), renders=True),
        Handler(calls.EXPORT_SCENE, lambda service, req: service.exports.file(req), renders=True),
        Handler(calls.LIST_PHOTOS, lambda service, req: service.photos.all(**vars(req))),
        Handler(calls.LIST_NEXT_PHOTOS, lambda service, req: service.photos.next_photos(**vars(req)), renders=True),
        Handler(calls.GET_GOAL, lambda service, req: service.exports.goal(**vars(req)), computes=True),
        Handler(calls.LIST_DETECTIONS, lambda service, req: service.answers.detections(**vars(req)), computes=True),
        Handler(calls.LOCALIZE, lambda service, req: service.localizing.localize(req), renders=True),
        Handler(calls.OBSERVE_SCENE, lambda service, req: service.observations.observe(req, caller_id())),
        Handler(calls.LIST_OBSERVATIONS, lambda service, req: service.observations.all(**vars(req)), computes=True),
        Handler(calls.GET_OBSERVATION, lambda service, req: service.observations.get(**vars(req)), computes=True),
        Handler(calls.LIST_BEST_VIEWS, lambda service, req: service.photos.best_views(**vars(req)), renders=True),
        Handler(calls.GET_CONTACT_SHEET, lambda service, req: service.sheets.page(**vars(req)), renders=True),
        Handler(calls.CREATE_KEY, lambda service, req: service.keys.create(caller_role(), req)),
        Handler(calls.CREATE_UPLOAD_KEY, lambda service, req: service.keys.create_for_upload(req)),
        Handler(calls.LIST_KEYS, lambda service, req: service.keys.list(caller_role(), **vars(req))),
        Handler(calls.REVOKE_KEY, lambda service, req: service.keys.revoke(caller_role(), req.key_id)),
        Handler(calls.ESTIMATE_JOB, lambda service, req: service.estimates.estimate(req), computes=True),
        Handler(calls.GET_SERVER_STATUS, lambda service, req: service.status(caller_role(), caller_id())),
        Handler(calls.LIST_PROJECTS, lambda service, req: service.admin.projects.all()),
        Handler(calls.CREATE_PROJECT, lambda service, req: service.admin.projects.create(req.name)),
        Handler(calls.LIST_KNOWN_NAMES, lambda service, req: service.known_names.list(**vars(req))),
        Handler(calls.DELETE_KNOWN_NAME, lambda service, req: service.known_names.forget(req.name_id)),
    )
}
"""Handlers by RPC name."""
