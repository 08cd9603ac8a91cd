"""Drafts: what can be asked while a job runs, and what becomes of edits, through its end, failure and crashes."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.settings import CallSettings, Settings
from fastsplat.workers.job.made_scenes import EDITS
from fastsplat.workers.job.protocol import Job
from fastsplat.workers.kinds import create_scene
from fastsplat.workers.kinds.progress_files import ProgressFiles
from fastsplat_contract.errors import NotReadyError
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3
from fastsplat_contract.jobs.job_watching import Provisional
from fastsplat_contract.jobs.look_again import LookAgainIn
from fastsplat_contract.jobs.operations import Operation, SceneOptions
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.messages.scenes import Color, Edit
from tests.api.made_scene import write_words
from tests.workers.deployment import Deployment, kill, new_database, on_both_databases
from tests.workers.draft_scenes import DRAFT_IDS, FINAL_IDS, ONLY_IN_DRAFT, PLACES

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


def test_a_draft_that_cannot_be_made_does_not_end_its_job(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever the reason: it is in the job's log."""

    def fail() -> Scene:
        raise IndexError("of a view that is not there")

    events: list[ProgressEvent] = []
    job = Job("operation", 1, tmp_path / "upload", tmp_path, SceneOptions(), Settings(data_dir=tmp_path))
    drafts = create_scene.Drafts(job, ProgressFiles(job, "perception", events.append))
    drafts.publish("perception", fail)
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
    late.send_signal(signal.SIGCONT)
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


_UP = Pose(Vector3(0.0, -2.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
_LEFT, _MIDDLE, _RIGHT = DRAFT_IDS


@pytest.fixture
def words(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Deployment]:
    """A deployment whose jobs make scenes of objects, and ask a text encoder."""
    write_words(tmp_path / "models", "Oskar", "ghost", "twin")
    with ExitStack() as opened:
        query = QuerySettings(backend="reference")
        few = CallSettings(max_versions=3)  # of a finished scene: what people make of a draft all stays
        deployment = Deployment(
            tmp_path, new_database(request, opened), models=tmp_path / "models", query=query, calls=few
        )
        deployment.start_worker(FASTSPLAT_MODELS=str(tmp_path / "models"))
        yield deployment
        deployment.close()


def _drafted(deployment: Deployment, *orders: str) -> Operation:
    operation = deployment.post("training:draft", *orders)
    deployment.wait_for(lambda: deployment.service.get_operation(operation.id).draft is not None)
    return operation


def _names(deployment: Deployment, operation: Operation) -> dict[int, str]:
    objects = deployment.service.answers.list_objects(operation.scene_id).objects
    return {obj.id: obj.name for obj in objects}


def test_edits_of_a_draft_hold_by_object(words: Deployment) -> None:
    """Names, colors, copies follow their objects whatever the ids; undone edits do not; each is its own version."""
    operation = _drafted(words, "training:until_told")
    edit = words.service.versions.edit
    scene_id = operation.scene_id
    named = [Edit("name", object_ids=(_RIGHT,), name="Oskar"), Edit("name", object_ids=(ONLY_IN_DRAFT,), name="ghost")]
    edit(scene_id, named, "a-request")
    edit(scene_id, [Edit("recolor", object_ids=(_LEFT, ONLY_IN_DRAFT), color=Color(1.0, 0.0, 0.0))])
    edit(scene_id, [Edit("duplicate", object_ids=(_MIDDLE,), transform=_UP)])
    copy = max(_names(words, operation))
    edit(scene_id, [Edit("name", object_ids=(copy,), name="twin")])
    edit(scene_id, [Edit("discard", object_ids=(_LEFT,))])
    words.service.versions.undo(scene_id)
    answer = words.service.answers.query(QueryRequest(scene_id, ("Oskar",))).answers[0]
    assert answer.provisional is not None and answer.object_ids == (_RIGHT,)
    _tell(words)
    done = words.wait_over(operation)
    assert done.state == "SUCCEEDED"
    left, middle, right = FINAL_IDS
    names = _names(words, operation)
    assert names == {left: "", middle: "", right: "Oskar", max(names): "twin"} and len(names) == 4
    answer = words.service.answers.query(QueryRequest(scene_id, ("Oskar",))).answers[0]
    assert (answer.object_ids, answer.provisional) == ((right,), None)
    twin = next(t for t in words.service.answers.list_objects(scene_id).objects if t.name == "twin")
    assert abs(twin.centroid.x - PLACES[1]) < 0.2 and abs(twin.centroid.y + 2.0) < 0.2
    assert done.create_scene is not None and done.create_scene.carried == 4
    known = {
        name.name: np.frombuffer(name.appearance[-6:], np.float16) for name in words.service._store.known_names.all()
    }
    assert known.keys() == {"Oskar", "twin"}, "what they are known by in other scenes"
    assert all(size == pytest.approx([0.1] * 3, abs=0.05) for size in known.values()), "their spread in meters"
    assert [text.partition(":")[0] for text in done.create_scene.lost] == ["name 'ghost'", "recolor"]
    versions = words.service.versions.all(scene_id)
    assert [[change.action for change in version.edits] for version in versions] == [
        [], ["name"], ["recolor"], ["duplicate"], ["name"],
    ]  # fmt: skip
    assert edit(scene_id, named, "a-request").version == versions[1].version
    for _ in versions[1:]:
        words.service.versions.undo(scene_id)
    assert set(_names(words, operation).values()) == {""}
    words.wait_for(lambda: len(list((words.settings.data_dir / "scenes" / scene_id).iterdir())) == len(versions))


def test_an_edit_at_the_last_moment_holds(words: Deployment) -> None:
    """One that comes when the scene is already made is in it all the same, and costs no stage again but the last."""
    operation = _drafted(words, "export:until_told")
    words.wait_in("export", operation)
    words.service.versions.edit(operation.scene_id, [Edit("name", object_ids=(_LEFT,), name="Oskar")])
    _tell(words)
    assert words.wait_over(operation).error is None
    assert _names(words, operation)[FINAL_IDS[0]] == "Oskar"
    assert [len(words.visits(stage, operation)) for stage in ("training", "export")] == [1, 2]


def test_a_draft_takes_over_edits_of_the_one_before_and_loses_none(words: Deployment) -> None:
    """A later draft has the names of the one before; its objects are the same, so the names hold to the end."""
    operation = _drafted(words, "training:until_told", "training:draft", "export:until_asked")
    words.service.versions.edit(operation.scene_id, [Edit("name", object_ids=(_MIDDLE,), name="Oskar")])
    # Until the worker has seen it: a draft made without it is not published.
    words.wait_for(lambda: any("Oskar" in path.read_text() for path in words.settings.data_dir.rglob(EDITS)))
    _tell(words)
    words.wait_for(lambda: (draft := words.service.get_operation(operation.id).draft) and draft.number == 2)
    assert _names(words, operation)[_MIDDLE] == "Oskar"
    (words.settings.data_dir / "asked.txt").touch()
    assert words.wait_over(operation).error is None
    assert _names(words, operation)[FINAL_IDS[1]] == "Oskar"
