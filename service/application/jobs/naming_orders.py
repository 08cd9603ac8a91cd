"""Requests for names in a finished scene, validated here and run by a worker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from fastsplat.service.application.admin.server_capabilities import captioner_status
from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.validate import check_request_id, check_texts
from fastsplat.service.application.jobs.running_jobs import RunningJobs
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.common.setting_groups import environment_variable
from fastsplat.service.scene.objects.objects import checked_name
from fastsplat.service.settings import CaptionerSettings, Settings, StoreOptions
from fastsplat.service.store.repositories.scene_repository import order_job
from fastsplat.service.store.rows.records import NewJob
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.errors import (
    InvalidInputError,
    LimitExceededError,
    ModelUnavailableError,
    PermissionDeniedError,
)
from fastsplat_contract.jobs.look_again import LookAgainIn
from fastsplat_contract.jobs.name_suggestions import CaptionerStatus
from fastsplat_contract.jobs.operations import Operation


def look_again_job(scene_id: str, request: LookAgainIn, project: str, settings: Settings) -> NewJob:
    """Creates the job that searches a scene for more texts.

    Raises:
        InvalidInputError: no texts, or an empty, duplicate or multi-line one, or one unknown to the detector.
        LimitExceededError: too many texts, or too long ones.
        ModelUnavailableError: no open-set detector is configured.
    """
    check_request_id(request.request_id)
    check_texts(request.texts, "texts")
    texts = _checked(request.texts, settings.store)
    _check_models(texts, settings)
    return order_job("look_again", scene_id, request.request_id, to_plain(LookAgainIn(texts)), project)


def _checked(texts: Sequence[str], limits: StoreOptions) -> tuple[str, ...]:
    """Validated texts, stripped."""
    if not texts:
        raise InvalidInputError(
            "no texts", field="texts", limit=f"1 to {limits.max_labels} texts", hint="Say what to look for."
        )
    if len(texts) > limits.max_labels:
        raise LimitExceededError(
            f"{len(texts)} texts",
            field="texts",
            limit=f"{limits.max_labels} texts",
            hint="Look for them in several operations.",
        )
    first: dict[str, int] = {}
    checked = []
    for number, text in enumerate(texts):
        field = f"texts[{number}]"
        if len(text) > limits.max_label_chars:
            raise LimitExceededError(
                f"a text of {len(text)} characters",
                field=field,
                limit=f"{limits.max_label_chars} characters",
                hint="A word or two say what an object is.",
            )
        checked.append(checked_name(text, field))
        key = label_key(checked[-1])
        if not key:
            raise InvalidInputError(f"{text[:80]!r} has no word to look for", field=field, hint="Say what to look for.")
        if key in first:
            raise InvalidInputError(
                f"{text[:80]!r} is the same as texts[{first[key]}], {texts[first[key]][:80]!r}",
                field=field,
                limit="each text once; case and plural do not matter",
                hint="Leave one out.",
            )
        first[key] = number
    return tuple(checked)


def _check_models(texts: Sequence[str], settings: Settings) -> None:
    from fastsplat.service.perception.detectors.open_detectors import check_open_set_detector, check_texts_known

    check_open_set_detector(settings.perception)
    check_texts_known(texts, settings.perception, settings.models, field="texts")


class OwnCaptioner:
    """The server's captioner for one project. Thread-safe."""

    def __init__(self, context: ProjectContext, jobs: RunningJobs) -> None:
        self._context, self._jobs = context, jobs

    def agree(self, host: str) -> CaptionerStatus:
        """Records the project's consent to the captioner's host; "" withdraws it.

        Raises:
            ModelUnavailableError: the server has no captioner.
            InvalidInputError: the captioner has another host.
        """
        status = self._status()
        if host and host != status.host:
            raise InvalidInputError(
                f"the server's captioner is not at {host[:200]!r}", field="host", limit=f"{status.host}, or empty"
            )
        self._context.store.projects.agree(self._context.project, host)
        return replace(status, agreed=bool(host))

    def order(self, scene_id: str, request_id: str = "") -> Operation:
        """Queues a job that asks the captioner about all unnamed objects; durable on return.

        Usable suggestions become one version. The same `request_id` returns the same operation; "" for none.

        Raises:
            NotFoundError, NotReadyError: no such scene, or it is not ready.
            ModelUnavailableError: the server has no captioner.
            PermissionDeniedError: the project did not agree to the host.
            ConflictError, QuotaError: as `RunningJobs.order`.
        """
        check_request_id(request_id)
        self._context.scenes.finished(scene_id)
        status = self._status()
        if not status.agreed:
            raise PermissionDeniedError(
                f"the project did not agree that pictures of its objects go to {status.host}",
                field="captioner",
                hint="An admin of the project agrees once, on the page or by AgreeToCaptioner.",
            )
        job = order_job("ask_captioner", scene_id, request_id, {}, self._context.project)
        return self._jobs.order(job)

    def _status(self) -> CaptionerStatus:
        status = captioner_status(self._context.store, self._context.settings, self._context.project)
        if status is None:
            raise ModelUnavailableError(
                "this server has no captioner",
                field="captioner",
                hint=f"Set {environment_variable(CaptionerSettings, 'url')}.",
            )
        return status
