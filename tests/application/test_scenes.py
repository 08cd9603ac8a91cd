"""Scenes: listed in pages, deleted with their files, found or not."""

from __future__ import annotations

import pytest

from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.messages.scenes import Edit


def test_pages_stay_stable_while_scenes_come_and_go(service, post):
    posted = [post(str(number)).id for number in range(6)]
    page, token = service.list_scenes(2)
    service.delete_scene(page[-1].id)
    post("newcomer")
    rest, _ = service.list_scenes(4, token)
    assert [scene.id for scene in rest] == posted[3::-1]


def test_a_list_says_how_many_objects_each_scene_has_as_it_is_edited(service, post, finish):
    info = post()
    assert service.list_scenes().scenes[0].object_count is None  # there is no version yet

    def said() -> tuple[int | None, int | None]:
        listed = len(service.answers.list_objects(info.id).objects)
        assert service.get_scene(info.id).object_count == listed
        return service.list_scenes().scenes[0].object_count, listed

    finish(info)
    counts = [said()]
    service.versions.edit(info.id, [Edit("remove", label="mug")])
    counts.append(said())
    service.versions.undo(info.id)
    counts.append(said())
    service.versions.redo(info.id)
    counts.append(said())
    assert counts == [(2, 2), (1, 1), (2, 2), (1, 1)]


def test_page_sizes_are_cut_and_checked(service, post):
    for number in range(6):
        post(str(number))
    assert len(service.list_scenes(1000)[0]) == 4
    assert len(service.list_scenes(0)[0]) == 4
    scene_id = service.list_scenes(1).scenes[0].id
    for call in (service.list_scenes, service.list_operations, lambda size: service.list_labels(scene_id, size)):
        with pytest.raises(InvalidInputError, match="a page size of -1") as caught:
            call(-1)
        assert caught.value.field == "page_size" and "scene" not in caught.value.message


@pytest.mark.parametrize("token", ["x", "bm90IGpzb24", "W10", "W251bGwsIDFd", "🙂", "W05hTiwgImEiXQ", "[" * 5000])
def test_a_foreign_page_token_is_refused(service, token):
    with pytest.raises(InvalidInputError) as caught:
        service.list_scenes(1, token)
    assert caught.value.field == "page_token"


def test_deleted_is_gone_from_disk_and_database(service, settings, post, finish):
    info = post()
    finish(info)
    service.answers.query(QueryRequest("", ("mug",)))
    service.delete_scene(info.id)
    for call in (service.get_scene, service.delete_scene, service.answers.scene_ply):
        with pytest.raises(NotFoundError) as caught:
            call(info.id)
        assert caught.value.hint
    assert service.answers.query(QueryRequest("", ("mug",))).answers == ()
    assert list((settings.data_dir / "scenes").iterdir()) == []
    assert list((settings.data_dir / "uploads").iterdir()) == []
    assert service.get_operation(info.operation_id).state == "SUCCEEDED"
