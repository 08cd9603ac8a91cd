"""Views of surfaces: rendered once for points, mesh and cameras, and gone when others need their memory."""

from __future__ import annotations

import pytest

from fastsplat.service.application.base.memory import MemoryBudget
from fastsplat.service.application.exporting import scene_exports
from fastsplat.service.application.exporting.geometry_files import cameras_file, mesh_file, points_file
from fastsplat.service.application.exporting.scene_exports import SurfaceCache
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.surface_views import SurfaceView, surface_views
from fastsplat.service.settings import CallSettings
from tests.query.wall import wall_index

_GIB = 1 << 30


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[SceneIndex]:
    scenes = []

    def counting(index: SceneIndex) -> tuple[SurfaceView, ...]:
        scenes.append(index)
        return surface_views(index)

    monkeypatch.setattr(scene_exports, "surface_views", counting)
    return scenes


def test_points_mesh_and_cameras_share_one_rendering_and_are_what_they_are_alone(rendered: list[SceneIndex]) -> None:
    memory = MemoryBudget(CallSettings(answer_memory_bytes=_GIB), _GIB)
    cache, index = SurfaceCache(memory), wall_index()
    for file in (points_file, mesh_file, cameras_file):
        assert file(index, "wall", (), 0.05, lambda idx: cache.views("wall", "1", idx)) == file(index, "wall", (), 0.05)
    assert len(rendered) == 1 and memory.cached_bytes > 0
    edited_index = wall_index()
    cache.views("wall", "2", edited_index)  # what an edit changed
    cache.views("wall", "2", edited_index)
    assert rendered == [index, edited_index]
    cache.forget("wall")
    cache.views("wall", "2", edited_index)
    assert len(rendered) == 3


def test_they_leave_for_a_call_that_needs_their_memory(rendered: list[SceneIndex]) -> None:
    memory = MemoryBudget(CallSettings(answer_memory_bytes=_GIB, request_memory_bytes=_GIB), _GIB)
    cache, index = SurfaceCache(memory), wall_index()
    first = cache.views("wall", "1", index)
    with memory.reserve(_GIB, "scene_id"):
        assert memory.cached_bytes == 0
        assert cache.views("wall", "1", index) is not first  # no room to keep these
        cache.views("wall", "1", index)
    assert len(rendered) == 3
    cache.views("wall", "1", index)
    cache.views("wall", "1", index)
    assert len(rendered) == 4 and memory.cached_bytes > 0
