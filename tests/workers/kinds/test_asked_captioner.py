"""The server's captioner is asked about a scene by a job of its own, where the project agreed, and once."""

from __future__ import annotations

import json
import subprocess
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.settings import CaptionerSettings
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.messages.contact_sheets import ContactSheet, SheetObject
from fastsplat_contract.messages.scenes import Edit
from tests.api.made_scene import write_words
from tests.client.replay_captioner import ReplayCaptioner, named, replayed
from tests.workers.deployment import Deployment, kill, new_database
from tests.workers.draft_scenes import FINAL_IDS

_NAMES = dict(zip(FINAL_IDS, ("mug", "ball", "story book"), strict=True))
_OBJECTS = tuple(SheetObject(n, obj, "front.png", False, None, "", (), ()) for n, obj in enumerate(FINAL_IDS, start=1))
_SHEET = ContactSheet(b"", _OBJECTS, (), False, "", "")


class Rig(NamedTuple):
    """A deployment whose jobs make scenes of three objects, and its captioner, which knows them."""

    deployment: Deployment
    captioner: ReplayCaptioner
    settings: CaptionerSettings

    def start_worker(self, agreed: bool = True) -> subprocess.Popen[bytes]:
        if agreed:
            self.agree()
        return self.deployment.start_worker(
            FASTSPLAT_QUERY__BACKEND="reference",
            FASTSPLAT_CAPTIONER__URL=self.captioner.url,
            FASTSPLAT_CAPTIONER__MODEL="eyes",
            FASTSPLAT_CAPTIONER__KEY="secret",
        )

    def agree(self) -> None:
        self.deployment.service.captioner.agree(self.settings.host)

    def finished_scene(self) -> Operation:
        done = self.deployment.wait_over(self.deployment.post())
        assert done.state == "SUCCEEDED", done.error
        return done

    def asking(self, scene_id: str) -> list[Operation]:
        listed = self.deployment.service.list_operations().operations
        return [job for job in listed if job.scene_id == scene_id and job.kind == "ask_captioner"]

    def order(self, *orders: str) -> None:
        """What the fake stages around the asking do."""
        (self.deployment.settings.data_dir / "orders.txt").write_text("\n".join(orders))


@pytest.fixture
def rig(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Rig]:
    write_words(tmp_path / "models", "mug")
    with ExitStack() as opened:
        captioner = opened.enter_context(replayed([], lambda sheet: named(sheet, _NAMES, 0.9)))
        captioner.sheets = defaultdict(lambda: _SHEET)
        settings = CaptionerSettings(url=captioner.url, model="eyes", key="secret")
        url, query = new_database(request, opened), QuerySettings(backend="reference")
        deployment = Deployment(tmp_path, url, models=tmp_path / "models", query=query, captioner=settings)
        yield Rig(deployment, captioner, settings)
        deployment.close()


def test_a_new_scene_of_a_project_that_agreed_gets_suggestions_unasked_and_no_name(rig: Rig) -> None:
    rig.start_worker()
    creation = rig.finished_scene()
    (operation,) = rig.asking(creation.scene_id)
    done = rig.deployment.wait_over(operation)
    assert done.state == "SUCCEEDED" and [stage.stage for stage in done.stages] == ["asking", "suggesting"]
    assert done.ask_captioner is not None and (done.ask_captioner.suggested, done.ask_captioner.problem) == (3, "")
    service = rig.deployment.service
    first, second = service.versions.all(creation.scene_id)
    assert done.ask_captioner.version == second.version and second.parent == first.version and second.current
    assert [edit.action for edit in second.edits] == ["suggest"]
    objects = service.answers.list_objects(creation.scene_id).objects
    assert {obj.id: obj.suggestions[0].name for obj in objects} == _NAMES and not any(obj.name for obj in objects)
    assert {speaker.source for obj in objects for suggestion in obj.suggestions for speaker in suggestion.said_by} == {
        "eyes"
    }
    assert [headers["authorization"] for _, headers, _ in rig.captioner.got] == ["Bearer secret"]
    sent = json.dumps([body for _, _, body in rig.captioner.got])
    scene = service.get_scene(creation.scene_id)
    for private in (scene.id, scene.name, *(camera.name for camera in scene.cameras)):
        assert private and private not in sent
    assert "secret" not in str([path.read_bytes() for path in rig.deployment.settings.data_dir.rglob("*.json")])
    assert service.versions.undo(creation.scene_id).version == first.version
    rig.deployment.wait_for(lambda: not rig.deployment.left_over())


def test_nothing_is_sent_for_a_project_that_did_not_agree_or_took_it_back(rig: Rig) -> None:
    worker = rig.start_worker(agreed=False)
    assert not rig.asking(rig.finished_scene().scene_id)
    rig.agree()
    rig.order("capture:nothing")
    waiting = rig.deployment.post("export:sleep_once 600")
    rig.deployment.wait_in("export", waiting)
    kill(worker)
    rig.deployment.service.captioner.agree("")
    rig.start_worker(agreed=False)
    assert rig.deployment.wait_over(waiting).state == "SUCCEEDED"
    assert not rig.asking(waiting.scene_id) and not rig.captioner.got


def test_an_agreement_that_is_taken_back_ends_a_job_that_asks(rig: Rig) -> None:
    rig.start_worker()
    rig.order("asking:sleep 600")
    creation = rig.finished_scene()
    (operation,) = rig.asking(creation.scene_id)
    rig.deployment.wait_in("asking", operation)
    rig.deployment.service.captioner.agree("")
    assert rig.deployment.wait_over(operation).state == "CANCELLED"
    rig.deployment.service.retry_operation(operation.id)
    rig.deployment.wait_for(lambda: rig.deployment.state(operation) == "FAILED")
    error = rig.deployment.service.get_operation(operation.id).error
    assert error is not None and error.reason == "PERMISSION_DENIED"
    assert len(rig.captioner.got) == 1 and len(rig.deployment.service.versions.all(creation.scene_id)) == 1


@pytest.mark.parametrize(
    ("rig", "order", "requests"),
    [
        ("sqlite", "asking:kill_worker_until 1", 2),
        ("sqlite", "suggesting:kill_worker_until 1", 1),
        ("postgresql", "suggesting:kill_worker_until 1", 1),
    ],
    indirect=["rig"],
)
def test_a_killed_worker_leads_to_one_batch(rig: Rig, order: str, requests: int) -> None:
    worker = rig.start_worker()
    rig.order(order)
    creation = rig.finished_scene()
    rig.deployment.wait_for(lambda: worker.poll() is not None)
    rig.start_worker(agreed=False)
    (operation,) = rig.asking(creation.scene_id)
    assert rig.deployment.wait_over(operation).state == "SUCCEEDED"
    assert [len(version.edits) for version in rig.deployment.service.versions.all(creation.scene_id)] == [0, 1]
    assert len(rig.captioner.got) == requests


@pytest.mark.parametrize("says", [(500, {}, b""), {"names": []}], ids=["it fails", "it knows nothing"])
def test_a_captioner_that_helps_nothing_leaves_the_scene_as_it_is(rig: Rig, says: Any) -> None:
    rig.captioner.says = lambda _: says
    rig.start_worker()
    creation = rig.finished_scene()
    (operation,) = rig.asking(creation.scene_id)
    done = rig.deployment.wait_over(operation)
    if isinstance(says, tuple):
        assert done.state == "FAILED" and done.error is not None and done.error.reason == "CAPTIONER_FAILED"
        assert len(rig.captioner.got) == 3
    else:
        assert done.ask_captioner is not None and (done.ask_captioner.suggested, done.ask_captioner.objects) == (0, 3)
    scene = rig.deployment.service.get_scene(creation.scene_id)
    (version,) = rig.deployment.service.versions.all(creation.scene_id)
    assert (scene.state, scene.version) == ("READY", version.version)
    rig.deployment.wait_for(lambda: not rig.deployment.left_over(operation))


def test_suggestions_go_into_what_people_made_of_the_scene_meanwhile(rig: Rig) -> None:
    rig.start_worker()
    rig.order("suggesting:sleep_once 3")
    creation = rig.finished_scene()
    (operation,) = rig.asking(creation.scene_id)
    rig.deployment.wait_in("suggesting", operation)
    edit = Edit("discard", object_ids=(FINAL_IDS[0],))
    rig.deployment.service.versions.edit(creation.scene_id, [edit])
    done = rig.deployment.wait_over(operation)
    assert done.ask_captioner is not None and done.ask_captioner.suggested == 2
    objects = rig.deployment.service.answers.list_objects(creation.scene_id).objects
    assert {obj.id: obj.suggestions[0].name for obj in objects} == {n: _NAMES[n] for n in FINAL_IDS[1:]}
    assert len(rig.captioner.got) == 1
