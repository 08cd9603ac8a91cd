"""Drafts: what can be asked while a job runs, through its end, failure, cancellation and crashes."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.capture.captures import Capture, CaptureReport
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.settings import Settings
from fastsplat.workers.job.protocol import Job
from fastsplat.workers.kinds import create_scene
from fastsplat.workers.kinds.progress_files import ProgressFiles
from fastsplat_contract.errors import NotReadyError
from fastsplat_contract.jobs.job_watching import Provisional
from fastsplat_contract.jobs.look_again import LookAgainIn
from fastsplat_contract.jobs.operations import Operation, SceneOptions
from tests.workers.deployment import Deployment, kill, on_both_databases

_POINTS, _TRAINING = Provisional("points", 0.0), Provisional("training", 0.5)


def _wait_told(deployment: Deployment, operation: Operation) -> None:
    """Until the newest draft was told."""
    deployment.wait_for(lambda: deployment.service.get_operation(operation.id).draft is not None)


def _tell(deployment: Deployment) -> None:
    (deployment.settings.data_dir / "told.txt").touch()


def _versions_stored(deployment: Deployment, operation: Operation) -> list[str]:
    folder = deployment.settings.data_dir / "scenes" / operation.scene_id
    return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []


def _wait_alone(deployment: Deployment, operation: Operation) -> None:
    """Until the scene's current version is the only one on disk."""
    version = deployment.service.get_scene(operation.scene_id).version
    deployment.wait_for(lambda: _versions_stored(deployment, operation) == [version])


def test_a_draft_that_cannot_be_made_does_not_end_its_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever the reason: it is in the job's log."""

    def fail(*_: object) -> Scene:
        raise IndexError("of a view that is not there")

    monkeypatch.setattr(create_scene, "first_draft", fail)
    events: list[ProgressEvent] = []
    job = Job("operation", 1, tmp_path / "upload", tmp_path, SceneOptions(), Settings(data_dir=tmp_path))
    drafts = create_scene.Drafts(job, ProgressFiles(job, "perception", events.append))
    report = CaptureReport("images", 0)
    capture = Capture((), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), "metric", report)
    drafts.of_points(capture, Labelling(Dictionary(()), ()), ())
    assert not events and "of a view that is not there" in capsys.readouterr().err


@on_both_databases()
def test_a_draft_is_a_version_until_the_scene_is_done(deployment: Deployment) -> None:
    """It can be read while the job runs, says what it is, is told, and leaves no trace in the finished scene."""
    deployment.start_worker()
    operation = deployment.post("perception:draft", "training:draft", "training:until_told")
    deployment.wait_for(lambda: deployment.service.get_scene(operation.scene_id).provisional == _TRAINING)
    deployment.wait_for(lambda: (draft := deployment.service.get_operation(operation.id).draft) and draft.number == 2)
    draft = deployment.service.get_operation(operation.id).draft
    scene = deployment.service.get_scene(operation.scene_id)
    assert draft is not None and (draft.number, draft.version) == (2, scene.version)
    assert (scene.state, len(scene.dictionary), len(scene.cameras), scene.assessment) == ("TRAINING", 2, 1, None)
    versions = deployment.service.versions.all(operation.scene_id)
    assert [version.current for version in versions] == [False, True]
    assert deployment.service.answers.scene_ply(operation.scene_id, versions[0].version)[0].is_file()
    _tell(deployment)
    assert deployment.wait_over(operation).draft is None
    scene = deployment.service.get_scene(operation.scene_id)
    assert (scene.state, scene.provisional) == ("READY", None)
    assert [version.version for version in deployment.service.versions.all(operation.scene_id)] == [scene.version]
    _wait_alone(deployment, operation)
    deployment.wait_for(lambda: not deployment.left_over(operation))


def test_a_job_that_ends_early_leaves_its_newest_draft(deployment: Deployment) -> None:
    """Failed or cancelled: the state says so, and what is there can be asked; a retry goes on from there."""
    deployment.start_worker()
    failed = deployment.post("training:draft", "export:fail")
    assert deployment.wait_over(failed).state == "FAILED"
    cancelled = deployment.post("training:draft", "training:sleep 600")
    _wait_told(deployment, cancelled)
    deployment.service.cancel_operation(cancelled.id)
    assert deployment.wait_over(cancelled).state == "CANCELLED"
    for operation, state in ((failed, "FAILED"), (cancelled, "CANCELLED")):
        scene = deployment.service.get_scene(operation.scene_id)
        assert (scene.state, scene.provisional) == (state, _TRAINING)
        assert deployment.service.answers.scene_ply(operation.scene_id)[1] == scene.version
        assert _versions_stored(deployment, operation) == [scene.version]


def test_a_deleted_scene_takes_its_drafts_along(deployment: Deployment) -> None:
    deployment.start_worker()
    operation = deployment.post("training:draft", "training:until_told", "training:draft", "training:sleep 600")
    _wait_told(deployment, operation)
    deployment.service.delete_scene(operation.scene_id)
    _tell(deployment)
    deployment.wait_over(operation)
    deployment.wait_for(lambda: not _versions_stored(deployment, operation))


@pytest.mark.parametrize("who", ["trainer", "worker"])
def test_a_crash_costs_no_draft(deployment: Deployment, who: str) -> None:
    """Whoever dies: the draft before can be asked meanwhile, and the next attempt's draft takes its place."""
    worker = deployment.start_worker()
    operation = deployment.post("perception:draft", "training:draft_kill_in 2", "training:until_told", "training:draft")
    deployment.wait_for(lambda: deployment.service.get_scene(operation.scene_id).provisional == _POINTS)
    trainer = deployment.wait_in("training", operation)
    if who == "trainer":
        os.kill(trainer, signal.SIGKILL)
    else:
        kill(worker)
        assert deployment.service.answers.scene_ply(operation.scene_id)[0].is_file()
        deployment.start_worker()
    deployment.wait_in("training", operation, visit=3)  # the second one died in the middle of its draft
    _tell(deployment)
    assert deployment.wait_over(operation).state == "SUCCEEDED"
    _wait_alone(deployment, operation)


def test_a_late_copy_publishes_no_draft(deployment: Deployment) -> None:
    """A worker that was suspended, and whose job another one has, changes nothing when it wakes."""
    late = deployment.start_worker()
    operation = deployment.post("training:sleep_once 3", "training:draft", "training:until_told")
    deployment.wait_in("training", operation)
    deployment.suspend(late)
    deployment.start_worker(elsewhere=True)
    deployment.wait_for(lambda: deployment.service.get_scene(operation.scene_id).provisional == _TRAINING)
    before = deployment.service.get_scene(operation.scene_id).version
    deployment.resume(late)
    deployment.wait_for(lambda: len(deployment.visits("training", operation)) == 2)
    _tell(deployment)
    assert deployment.wait_over(operation).state == "SUCCEEDED"
    assert "-2-" in before
    kill(late)
    _wait_alone(deployment, operation)


def test_no_job_is_ordered_on_a_draft(deployment: Deployment) -> None:
    deployment.start_worker()
    operation = deployment.post("training:draft", "training:until_told")
    _wait_told(deployment, operation)
    with pytest.raises(NotReadyError, match="still being made"):
        deployment.service.look_again(operation.scene_id, LookAgainIn(("mug",)))
    _tell(deployment)
    deployment.wait_over(operation)
