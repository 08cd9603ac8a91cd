"""Scenes: listed in pages, deleted with their files, found or not."""

from __future__ import annotations

import pytest

from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.queries import QueryRequest


def test_unknown_ids_are_not_found(service):
    for call in (service.get_scene, service.delete_scene, service.get_operation, service.cancel_operation):
        with pytest.raises(NotFoundError) as caught:
            call("no-such-id")
        assert caught.value.hint


def test_pages_hold_every_scene_once_newest_first(service, post):
    posted = [post(str(number)).id for number in range(6)]
    seen, token, sizes = [], "", []
    while True:
        page, token = service.list_scenes(4, token)
        seen += [scene.id for scene in page]
        sizes.append(len(page))
        if not token:
            break
    assert seen == posted[::-1] and sizes == [4, 2]


def test_pages_stay_stable_while_scenes_come_and_go(service, post):
    posted = [post(str(number)).id for number in range(6)]
    page, token = service.list_scenes(2)
    service.delete_scene(page[-1].id)
    post("newcomer")
    rest, _ = service.list_scenes(4, token)
    assert [scene.id for scene in rest] == posted[3::-1]


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
    service.query(QueryRequest("", ("mug",)))
    service.delete_scene(info.id)
    for call in (service.get_scene, service.delete_scene, service.scene_ply):
        with pytest.raises(NotFoundError):
            call(info.id)
    assert service.query(QueryRequest("", ("mug",))) == ()
    assert list((settings.data_dir / "scenes").iterdir()) == []
    assert list((settings.data_dir / "uploads").iterdir()) == []
    assert service.get_operation(info.operation_id).state == "SUCCEEDED"
