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

from benchmarks.naming.replay import ReplayCaptioner, named, replayed
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.settings import CaptionerSettings
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.messages.contact_sheets import ContactSheet, SheetObject
from fastsplat_contract.messages.scenes import Edit
from tests.api.made_scene import write_words
from tests.workers.deployment import Deployment, kill, new_database
from tests.workers.draft_scenes import FINAL_IDS

_NAMES = dict(zip(FINAL_IDS, ("mug", "ball", "story book"), strict=True))
_SHOWN = tuple(SheetObject(n, obj, "front.png", False, None, "", (), ()) for n, obj in enumerate(FINAL_IDS, start=1))
_SHEET = ContactSheet(b"", _SHOWN, (), False, "", "")


class Asked(NamedTuple):
    """A deployment whose jobs make scenes of three objects, and its captioner, which knows them."""

    deployment: Deployment
    captioner: ReplayCaptioner
    settings: CaptionerSettings

    def start_worker(self) -> subprocess.Popen[bytes]:
        return self.deployment.start_worker(
            FASTSPLAT_QUERY__BACKEND="reference",
            FASTSPLAT_CAPTIONER__URL=self.captioner.url,
            FASTSPLAT_CAPTIONER__MODEL="eyes",
            FASTSPLAT_CAPTIONER__KEY="secret",
        )

    def agree(self) -> None:
        self.deployment.service.captioner.agree(self.settings.host)

    def made(self) -> Operation:
        done = self.deployment.wait_over(self.deployment.post())
        assert done.state == "SUCCEEDED", done.error
        return done

    def asking(self, scene_id: str) -> list[Operation]:
        listed = self.deployment.service.list_operations().operations
        return [each for each in listed if each.scene_id == scene_id and each.kind == "ask_captioner"]

    def order(self, *orders: str) -> None:
        """What the fake stages around the asking do."""
        (self.deployment.settings.data_dir / "orders.txt").write_text("\n".join(orders))


@pytest.fixture
def asked(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Asked]:
    write_words(tmp_path / "models", "mug")
    with ExitStack() as opened:
        captioner = opened.enter_context(replayed([], lambda sheet: named(sheet, _NAMES, 0.9)))
        captioner.sheets = defaultdict(lambda: _SHEET)
        settings = CaptionerSettings(url=captioner.url, model="eyes", key="secret")
        url, query = new_database(request, opened), QuerySettings(backend="reference")
        deployment = Deployment(tmp_path, url, models=tmp_path / "models", query=query, captioner=settings)
        yield Asked(deployment, captioner, settings)
        deployment.close()


def test_a_new_scene_of_a_project_that_agreed_gets_suggestions_unasked_and_no_name(asked: Asked) -> None:
    asked.start_worker()
    asked.agree()
    made = asked.made()
    (operation,) = asked.asking(made.scene_id)
    done = asked.deployment.wait_over(operation)
    assert done.state == "SUCCEEDED" and [stage.stage for stage in done.stages] == ["asking", "suggesting"]
    assert done.ask_captioner is not None and (done.ask_captioner.suggested, done.ask_captioner.problem) == (3, "")
    service = asked.deployment.service
    first, second = service.versions.all(made.scene_id)
    assert done.ask_captioner.version == second.version and second.parent == first.version and second.current
    assert [edit.action for edit in second.edits] == ["suggest"]
    objects = service.answers.list_objects(made.scene_id).objects
    assert {each.id: each.suggestions[0].name for each in objects} == _NAMES and not any(each.name for each in objects)
    assert {one.source for each in objects for told in each.suggestions for one in told.said_by} == {"eyes"}
    assert [headers["authorization"] for _, headers, _ in asked.captioner.got] == ["Bearer secret"]
    sent = json.dumps([body for _, _, body in asked.captioner.got])
    scene = service.get_scene(made.scene_id)
    for private in (scene.id, scene.name, *(camera.name for camera in scene.cameras)):
        assert private and private not in sent
    assert "secret" not in str([path.read_bytes() for path in asked.deployment.settings.data_dir.rglob("*.json")])
    assert service.versions.undo(made.scene_id).version == first.version
    asked.deployment.wait_for(lambda: not asked.deployment.left_over())


def test_nothing_is_sent_for_a_project_that_did_not_agree_or_took_it_back(asked: Asked) -> None:
    worker = asked.start_worker()
    assert not asked.asking(asked.made().scene_id)
    asked.agree()
    asked.order("capture:nothing")
    waiting = asked.deployment.post("export:sleep_once 600")
    asked.deployment.wait_in("export", waiting)
    kill(worker)
    asked.deployment.service.captioner.agree("")
    asked.start_worker()
    assert asked.deployment.wait_over(waiting).state == "SUCCEEDED"
    assert not asked.asking(waiting.scene_id) and not asked.captioner.got


def test_an_agreement_that_is_taken_back_ends_a_job_that_asks(asked: Asked) -> None:
    asked.start_worker()
    asked.agree()
    asked.order("asking:sleep 600")
    made = asked.made()
    (operation,) = asked.asking(made.scene_id)
    asked.deployment.wait_in("asking", operation)
    asked.deployment.service.captioner.agree("")
    assert asked.deployment.wait_over(operation).state == "CANCELLED"
    asked.deployment.service.retry_operation(operation.id)
    asked.deployment.wait_for(lambda: asked.deployment.state(operation) == "FAILED")
    error = asked.deployment.service.get_operation(operation.id).error
    assert error is not None and error.reason == "PERMISSION_DENIED"
    assert len(asked.captioner.got) == 1 and len(asked.deployment.service.versions.all(made.scene_id)) == 1


@pytest.mark.parametrize(
    ("asked", "order", "requests"),
    [
        ("sqlite", "asking:kill_worker_until 1", 2),
        ("sqlite", "suggesting:kill_worker_until 1", 1),
        ("postgresql", "suggesting:kill_worker_until 1", 1),
    ],
    indirect=["asked"],
)
def test_a_killed_worker_leads_to_one_batch(asked: Asked, order: str, requests: int) -> None:
    worker = asked.start_worker()
    asked.agree()
    asked.order(order)
    made = asked.made()
    asked.deployment.wait_for(lambda: worker.poll() is not None)
    asked.start_worker()
    (operation,) = asked.asking(made.scene_id)
    assert asked.deployment.wait_over(operation).state == "SUCCEEDED"
    assert [len(version.edits) for version in asked.deployment.service.versions.all(made.scene_id)] == [0, 1]
    assert len(asked.captioner.got) == requests


@pytest.mark.parametrize("says", [(500, {}, b""), {"names": []}], ids=["it fails", "it knows nothing"])
def test_a_captioner_that_helps_nothing_leaves_the_scene_as_it_is(asked: Asked, says: Any) -> None:
    asked.captioner.says = lambda _: says
    asked.start_worker()
    asked.agree()
    made = asked.made()
    (operation,) = asked.asking(made.scene_id)
    done = asked.deployment.wait_over(operation)
    if isinstance(says, tuple):
        assert done.state == "FAILED" and done.error is not None and done.error.reason == "CAPTIONER_FAILED"
        assert len(asked.captioner.got) == 3
    else:
        assert done.ask_captioner is not None and (done.ask_captioner.suggested, done.ask_captioner.shown) == (0, 3)
    scene = asked.deployment.service.get_scene(made.scene_id)
    (version,) = asked.deployment.service.versions.all(made.scene_id)
    assert (scene.state, scene.version) == ("READY", version.version)
    asked.deployment.wait_for(lambda: not asked.deployment.left_over(operation))


def test_suggestions_go_into_what_people_made_of_the_scene_meanwhile(asked: Asked) -> None:
    asked.start_worker()
    asked.agree()
    asked.order("suggesting:sleep_once 3")
    made = asked.made()
    (operation,) = asked.asking(made.scene_id)
    asked.deployment.wait_in("suggesting", operation)
    edit = Edit("discard", object_ids=(FINAL_IDS[0],))
    asked.deployment.service.versions.edit(made.scene_id, [edit])
    done = asked.deployment.wait_over(operation)
    assert done.ask_captioner is not None and done.ask_captioner.suggested == 2
    objects = asked.deployment.service.answers.list_objects(made.scene_id).objects
    assert {each.id: each.suggestions[0].name for each in objects} == {n: _NAMES[n] for n in FINAL_IDS[1:]}
    assert len(asked.captioner.got) == 1
