"""What is kept between calls: bounded together, and of no use to learn what another project asked."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fastsplat.service.application.base.cache import LeastRecentlyUsed
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.text.label_table import LabelTable
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.settings import Settings
from fastsplat_contract.messages.queries import QueryRequest
from tests.api.made_scene import ENCODER, made_scene, write_words
from tests.scenes import finish_job, queued_job


@pytest.fixture
def encoded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    sentences: list[str] = []
    encode = LabelTable.encode

    def counted(self: LabelTable, texts: Sequence[str]) -> Any:
        sentences.extend(texts)
        return encode(self, texts)

    monkeypatch.setattr(LabelTable, "encode", counted)
    return sentences


def _add(service: SceneService, settings: Settings, project: str) -> str:
    job, store = replace(queued_job(), project=project), service._store.in_project(project)
    store.scenes.create(job)
    finish_job(store, job.operation_id, made_scene(open_text_encoder(ENCODER, settings.models)))
    return job.scene_id


def test_what_one_project_asked_spares_another_no_encoding(tmp_path: Path, encoded: list[str]) -> None:
    write_words(tmp_path / "models")
    settings = Settings(
        data_dir=tmp_path / "data",
        models=tmp_path / "models",
        perception=PerceptionSettings(text_encoder=ENCODER),
        query=QuerySettings(backend="cpu", threshold=0.5, exact_threshold=0.95),
    )
    with open_service(settings) as service:
        answers = {}
        for project in ("a", "b"):
            service.admin.projects.create(project)
            space, scene_id = service.in_project(project), _add(service, settings, project)
            space.answers.query(QueryRequest(scene_id, ("cup",)))  # opens the scene
            encoded.clear()
            answers[project] = [space.answers.query(QueryRequest(scene_id, ("elephant",))).answers[0] for _ in range(2)]
            assert [text for text in encoded if "elephant" in text], project
            encoded.clear()
            again = service.in_project(project, scene_id).answers.query(QueryRequest(scene_id, ("elephant",))).answers
            assert encoded == [] and again[0] == answers[project][0]  # a link to the scene is of its project
        (cache,) = service._context.scenes._caches.values()
        assert len(cache.texts._recent) <= settings.query.cached_texts
    first, second = (replace(answers[project][0], scene_id="") for project in ("a", "b"))
    assert first == second


def test_values_that_are_made_at_once_weigh_no_more_than_all_may() -> None:
    cache: LeastRecentlyUsed[str, str] = LeastRecentlyUsed(10)
    both = threading.Barrier(2, timeout=10)

    def make(key: str) -> str:
        both.wait()
        return key

    threads = [threading.Thread(target=cache.get, args=(key, lambda: 10, lambda key=key: make(key))) for key in "ab"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert cache.bytes <= 10 and len(cache) == 1
