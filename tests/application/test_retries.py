"""Failed and cancelled jobs are tried again without the photos that are to blame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.settings import CallSettings, Settings
from fastsplat.workers.job.claimed_job import ClaimedJob
from fastsplat.workers.job.protocol import Job, read_job
from fastsplat.workers.job.results import operation_error
from fastsplat_contract.errors import (
    FastSplatError,
    InvalidInputError,
    NotReadyError,
    ReconstructionError,
    ResourceError,
    WorkerCrashedError,
)
from fastsplat_contract.jobs.operations import Operation, SceneOptions
from tests.capture.upload_files import photo_file
from tests.scenes import stand_in_models

_NAMES = tuple(f"IMG_{number}.png" for number in range(4))


@pytest.fixture
def service(tmp_path: Path) -> Iterator[SceneService]:
    """A service that reads photos."""
    models = stand_in_models(tmp_path / "models", "minilm_l6_int8")
    with open_service(Settings(data_dir=tmp_path / "data", models=models), validate_upload) as service:
        yield service


@pytest.fixture
def posted(service: SceneService) -> Operation:
    with service.new_upload() as upload:
        for number, name in enumerate(_NAMES):
            upload.write(f"holiday/{name}", [photo_file(number, (32, 24), "PNG")])
        return service.create_scene(upload, "", "", SceneOptions())


@pytest.fixture
def fail(service: SceneService, posted: Operation) -> Callable[[FastSplatError], Operation]:
    """Ends the job with an error of its capture stage, as its worker would."""

    def fail(error: FastSplatError) -> Operation:
        job, claim = _claimed(service, posted)
        service._store.jobs.fail(claim, operation_error(error, "capture", job))
        return service.get_operation(posted.id)

    return fail


def _claimed(service: SceneService, operation: Operation) -> tuple[Job, Any]:
    """What the trainer of the job's next attempt is told."""
    store = service._store
    claim = store.jobs.claim(operation.id)
    assert claim is not None
    claimed = ClaimedJob(store, claim, CallSettings())
    folder, _ = claimed.upload()
    settings = service._context.settings
    job = Job("job", 1, folder, claimed.folder, claimed.options, settings, exclude=claim.operation.excluded)
    return read_job(job.to_line(""))[0], claim


@pytest.mark.parametrize("field", ["IMG_2.png", "holiday/IMG_2.png"])
def test_an_error_of_one_photo_names_it_and_a_retry_leaves_it_out(
    service: SceneService, fail: Callable[[FastSplatError], Operation], field: str
) -> None:
    failed = fail(ReconstructionError("this photo fits nowhere", field=field))
    assert failed.error is not None and failed.error.photos == ("IMG_2.png",) and failed.error.recurs

    again = service.retry_operation(failed.id, failed.error.photos)

    assert (again.state, again.again_after) == ("QUEUED", "failed")
    assert again.left_out == {"holiday/IMG_2.png": "left out on request"}
    assert _claimed(service, again)[0].exclude == ("holiday/IMG_2.png",)


@pytest.mark.parametrize(
    ("error", "recurs"),
    [
        (ReconstructionError("no overlap"), True),
        (InvalidInputError("no photos", field="images"), True),
        (ResourceError("the disk is full"), False),
        (WorkerCrashedError("it died"), False),
    ],
)
def test_an_error_says_whether_the_same_job_would_meet_it_again(
    fail: Callable[[FastSplatError], Operation], error: FastSplatError, recurs: bool
) -> None:
    failed = fail(error)
    assert failed.error is not None
    assert (failed.error.recurs, failed.error.photos) == (recurs, ())


def test_what_retries_leave_out_adds_up_until_too_little_is_left(
    service: SceneService, fail: Callable[[FastSplatError], Operation]
) -> None:
    operation = fail(ReconstructionError("no overlap"))
    for name in ("IMG_0.png", "holiday/IMG_1.png"):
        service.retry_operation(operation.id, (name,))
        service.cancel_operation(operation.id)
    with pytest.raises(InvalidInputError, match="only 1 would be left") as refused:
        service.retry_operation(operation.id, ("IMG_3.png",))
    assert refused.value.field == "exclude" and refused.value.limit and refused.value.hint
    assert service.get_operation(operation.id).state == "CANCELLED"
    service.retry_operation(operation.id)
    assert _claimed(service, operation)[0].exclude == ("holiday/IMG_0.png", "holiday/IMG_1.png")


def test_a_photo_that_the_upload_does_not_have_is_refused_and_nothing_is_queued(
    service: SceneService, fail: Callable[[FastSplatError], Operation]
) -> None:
    operation = fail(ReconstructionError("no overlap"))
    with pytest.raises(InvalidInputError, match=r"no photo IMG_9\.png") as refused:
        service.retry_operation(operation.id, ("IMG_1.png", "IMG_9.png"))
    assert refused.value.field == "exclude" and refused.value.hint
    assert service.get_operation(operation.id).state == "FAILED"


def test_photos_are_left_out_of_ended_jobs_only_and_a_repeated_request_changes_nothing(
    service: SceneService, posted: Operation
) -> None:
    with pytest.raises(NotReadyError, match="QUEUED"):
        service.retry_operation(posted.id, ("IMG_1.png",))
    service.cancel_operation(posted.id)
    first = service.retry_operation(posted.id, ("IMG_1.png",))
    assert service.retry_operation(posted.id, ("IMG_1.png",)) == first  # the answer was lost on the way
    assert first.again_after == "cancelled"
