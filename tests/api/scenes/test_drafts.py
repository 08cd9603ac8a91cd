"""Drafts over all interfaces: the same answers in process, over REST and gRPC, and waiting for them."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.settings import Settings
from fastsplat.service.store.rows.records import NewJob
from fastsplat_client import Client
from fastsplat_contract.jobs.job_watching import Provisional, Until
from fastsplat_contract.messages.objects import PickRequest
from fastsplat_contract.messages.queries import Answer, QueryRequest
from tests.api.made_scene import ENCODER, made_scene
from tests.scenes import finish_job, queued_job

_POINTS, _TRAINING = Provisional("points", 0.0), Provisional("training", 0.25)


class _DraftScene:
    """A scene whose job gets further when it is told so."""

    def __init__(self, service: SceneService, settings: Settings) -> None:
        self.job: NewJob = queued_job("draft")
        self._store = service._store
        self._scene = made_scene(open_text_encoder(ENCODER, settings.models))
        self._store.scenes.create(self.job)
        self._versions = 0

    def publish(self, draft: Provisional | None) -> None:
        self._versions += 1
        finish_job(self._store, self.job.operation_id, self._scene, version=f"v{self._versions}", draft=draft)


def _said(answer: Answer) -> tuple[object, ...]:
    content = answer.outcome, answer.sentence, answer.object_ids, answer.gaussians, answer.mask3d
    return answer.scene_id, answer.text, answer.version, answer.provisional, content


@pytest.fixture
def draft(service: SceneService, api_settings: Settings) -> Iterator[_DraftScene]:
    """A scene with a draft of points."""
    draft = _DraftScene(service, api_settings)
    draft.publish(_POINTS)
    yield draft
    service.delete_scene(draft.job.scene_id)


def test_answers_of_a_draft_are_the_same_everywhere(draft: _DraftScene, service: SceneService, client: Client) -> None:
    """And those of the finished scene, but for what they are made of, as here it is made of the same."""
    scene_id = draft.job.scene_id
    request = QueryRequest(scene_id, ("mug", "a submarine"), outputs=frozenset({"mask3d", "objects"}))
    answers = service.answers.query(request).answers
    assert {answer.provisional for answer in answers} == {_POINTS}
    assert [*map(_said, client.ask_everywhere(request).answers)] == [*map(_said, answers)]
    assert [*map(_said, client.ask_everywhere(request, protocol="gRPC").answers)] == [*map(_said, answers)]
    scene = service.get_scene(scene_id)
    assert client.scene(scene_id).provisional == scene.provisional == _POINTS
    point = answers[0].objects[0].centroid if answers[0].objects else None
    assert point is not None
    picked = service.answers.pick(PickRequest(point=point, scene_id=scene_id))
    clicked = client.pick(scene_id, point=point)
    assert clicked.provisional == picked.provisional == _POINTS
    assert (clicked.object.id, clicked.version) == (picked.object.id, picked.version)
    draft.publish(None)
    final = service.answers.query(request).answers
    assert {answer.provisional for answer in final} == {None}
    assert [_said(answer)[-1] for answer in final] == [_said(answer)[-1] for answer in answers]


def test_waiting_ends_as_soon_as_the_scene_is_so_far(draft: _DraftScene, client: Client) -> None:
    def waited(until: Until) -> Provisional | None:
        return client.wait_for_scene(draft.job.scene_id, until).provisional

    assert waited("first") == _POINTS
    with ThreadPoolExecutor(2) as pool:
        good, done = pool.submit(waited, "good"), pool.submit(waited, "done")
        draft.publish(_TRAINING)
        assert good.result(60) == _TRAINING
        assert not done.done()
        draft.publish(None)
        assert done.result(60) is None


def test_a_question_to_all_scenes_asks_drafts_too(draft: _DraftScene, client: Client) -> None:
    answers = client.ask_everywhere(QueryRequest("", ("mug",))).answers
    assert {answer.provisional for answer in answers if answer.scene_id == draft.job.scene_id} == {_POINTS}
