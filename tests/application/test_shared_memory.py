"""What is kept between calls: bounded together, gone when others need it, and no way to learn what others asked."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.memory import MemoryBudget
from fastsplat.service.application.exporting import scene_exports
from fastsplat.service.application.exporting.geometry_files import cameras_file, mesh_file, points_file
from fastsplat.service.application.exporting.scene_exports import Exports
from fastsplat.service.application.service import open_service
from fastsplat.service.common.cache import LeastRecentlyUsed
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.text.text_encoders import LabelTable, open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.surface_views import SurfaceView, surface_views
from fastsplat.service.settings import CallSettings, Settings
from fastsplat_contract.messages.queries import QueryRequest
from tests.api.made_scene import ENCODER, made_scene, write_words
from tests.at_once import at_once
from tests.query.wall import wall_index
from tests.scenes import store_scene


@pytest.fixture
def encoded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    sentences: list[str] = []
    encode = LabelTable.encode

    def counted(self: LabelTable, texts: Sequence[str]) -> Any:
        sentences.extend(texts)
        return encode(self, texts)

    monkeypatch.setattr(LabelTable, "encode", counted)
    return sentences


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
            space, scene = service.in_project(project), made_scene(open_text_encoder(ENCODER, settings.models))
            scene_id = store_scene(space._store, scene, project=project)
            space.answers.query(QueryRequest(scene_id, ("cup",)))  # opens the scene
            encoded.clear()
            answers[project] = [space.answers.query(QueryRequest(scene_id, ("elephant",))).answers[0] for _ in range(2)]
            assert [text for text in encoded if "elephant" in text], project
            encoded.clear()
            again = service.in_project(project, scene_id).answers.query(QueryRequest(scene_id, ("elephant",))).answers
            twin = QueryRequest(store_scene(space._store, scene, project=project), ("elephant",))
            assert space.answers.query(twin).answers[0].matches == again[0].matches
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

    at_once(*(partial(cache.get, key, lambda: 10, partial(make, key)) for key in "ab"))
    assert cache.bytes <= 10 and len(cache) == 1


_GIB = 1 << 30


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[SceneIndex]:
    scenes = []

    def counting(index: SceneIndex) -> tuple[SurfaceView, ...]:
        scenes.append(index)
        return surface_views(index)

    monkeypatch.setattr(scene_exports, "surface_views", counting)
    return scenes


def _exports(memory: MemoryBudget) -> Exports:
    return Exports(cast(ProjectContext, SimpleNamespace(memory=memory, settings=Settings())))


def test_points_mesh_and_cameras_share_one_rendering_and_are_what_they_are_alone(rendered: list[SceneIndex]) -> None:
    memory = MemoryBudget(CallSettings(answer_memory_bytes=_GIB), _GIB)
    exports, index = _exports(memory), wall_index()
    for file in (points_file, mesh_file, cameras_file):
        assert file(index, "wall", (), 0.05, exports._views_of("wall", "1")) == file(index, "wall", (), 0.05)
    assert len(rendered) == 1 and memory.cached_bytes > 0
    edited_index = wall_index()
    views = exports._views_of("wall", "2")  # what an edit changed
    assert views(edited_index) is views(edited_index)
    assert rendered == [index, edited_index]
    exports.forget("wall")
    views(edited_index)
    assert len(rendered) == 3


def test_they_leave_for_a_call_that_needs_their_memory(rendered: list[SceneIndex]) -> None:
    memory = MemoryBudget(CallSettings(answer_memory_bytes=_GIB, request_memory_bytes=_GIB), _GIB)
    views, index = _exports(memory)._views_of("wall", "1"), wall_index()
    first = views(index)
    with memory.reserve(_GIB, "scene_id"):
        assert memory.cached_bytes == 0
        assert views(index) is not first  # no room to keep these
        views(index)
    assert len(rendered) == 3
    views(index)
    views(index)
    assert len(rendered) == 4 and memory.cached_bytes > 0
