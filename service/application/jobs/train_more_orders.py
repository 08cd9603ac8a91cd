"""Job requests to train a finished scene further: checked here, done by a worker."""

from __future__ import annotations

from dataclasses import replace

from fastsplat.service.application.base.validate import check_request_id, check_seconds
from fastsplat.service.application.jobs.scene_orders import order_job
from fastsplat.service.planning.presets import preset_name
from fastsplat.service.settings import Settings
from fastsplat.service.store.records import TRAIN_MORE, NewJob
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.train_more_messages import TrainMoreIn


def train_more_job(scene_id: str, version: str, request: TrainMoreIn, project: str, settings: Settings) -> NewJob:
    """The job that trains a scene further.

    Args:
        scene_id: which scene.
        version: that it begins with.
        request: for how long.
        project: whose scene it is.
        settings: limits.

    Raises:
        InvalidInputError: seconds and steps both, more steps than the settings allow, seconds that are none, or no such
            preset.
        LimitExceededError: more seconds than the settings allow.
    """
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
    order = to_plain(replace(request, request_id=""))
    return order_job(TRAIN_MORE, scene_id, request.request_id, order, project, version=version)
