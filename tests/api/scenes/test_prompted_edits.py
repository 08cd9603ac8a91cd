"""Objects split and added by a click or a box, over both protocols and in process."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.instances.discovery_settings import PromptOptions
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.errors import (
    ConflictError,
    FastSplatError,
    InvalidInputError,
    LimitExceededError,
    ModelUnavailableError,
    NotFoundError,
)
from fastsplat_contract.geometry.object_prompts import ObjectPrompt, Pixel, PixelBox
from fastsplat_contract.messages.scenes import Edit
from tests.api.made_scene import turned

_MUG, _BALL, _NOTHING = (15.5, 18.5), (24.5, 18.5), (2.5, 2.5)
_VIEWS = ("front.png", "photos/left side & ü.png", "a/b/right.png")


def _prompt(*pixels: tuple[float, float], **options: Any) -> ObjectPrompt:
    return replace(ObjectPrompt(view="front.png", pixels=tuple(Pixel(*pixel) for pixel in pixels)), **options)


_MERGE = Edit("merge", object_ids=(1, 2))
_SPLIT = Edit("split", object_ids=(1,), prompt=_prompt(_BALL))
_ADD = Edit("add", prompt=_prompt(_BALL))


def _owner(service: SceneService, scene_id: str) -> np.ndarray:
    return service._context.scenes.open(scene_id, "")[0].objects.owner


def _maps(service: SceneService, scene_id: str) -> list[np.ndarray]:
    index, _ = service._context.scenes.open(scene_id, "")
    return [index.objects.map(posed) for posed in index.scene.cameras]


def test_a_split_object_becomes_two_that_share_its_gaussians_and_its_masks(
    client: Client, service: SceneService, fresh_id: str
) -> None:
    truth = _owner(service, fresh_id)
    merged = client.edit_scene(fresh_id, [_MERGE])
    whole, owner = _maps(service, fresh_id), _owner(service, fresh_id)
    version = client.split_object(fresh_id, 1, "front.png", pixels=[_BALL], name="violin", aliases=["moon"])
    (new,) = version.prompted
    assert (new.edit, new.object_id, new.views[0]) == (0, 4, "front.png") and set(new.views) <= set(_VIEWS)
    after = _owner(service, fresh_id)
    assert {obj.id: obj.name for obj in client.objects(fresh_id)} == {1: "mug", 3: "story book", 4: "violin"}
    # Whoever was not split has the very Gaussians that it had; the object's own are divided among the two.
    np.testing.assert_array_equal(after[owner != 1], owner[owner != 1])
    np.testing.assert_array_equal(np.isin(after, (1, 4)), owner == 1)
    assert new.gaussian_count == (after == 4).sum()
    assert ((after == 4) & (truth == 2)).sum() >= 0.85 * max((after == 4).sum(), (truth == 2).sum())
    for before, now in zip(whole, _maps(service, fresh_id), strict=True):
        both = np.isin(now, (1, 4))
        assert (now == 4).any() and (now == 1).any()
        assert (both ^ (before == 1)).sum() <= 0.02 * (before == 1).sum()
    assert client.query(fresh_id, "moon")[0].object_ids == (4,)
    client.undo_edit(fresh_id, version.version)
    np.testing.assert_array_equal(_owner(service, fresh_id), owner)
    assert client.query(fresh_id, "violin")[0].is_absent and client.scene(fresh_id).version == merged.version


def test_a_version_keeps_what_was_made_over_restarts(
    client: Client, service: SceneService, api_settings: Settings, fresh_id: str
) -> None:
    version = client.edit_scene(fresh_id, [_MERGE, _SPLIT], request_id="take-apart")
    assert client.edit_scene(fresh_id, [_MERGE, _SPLIT], request_id="take-apart") == version
    assert version.edits == (_MERGE, _SPLIT) and [new.edit for new in version.prompted] == [1]
    owner = _owner(service, fresh_id)
    with open_service(api_settings) as again:
        assert next(known for known in again.versions.all(fresh_id) if known.current) == version
        np.testing.assert_array_equal(_owner(again, fresh_id), owner)


def test_a_missing_object_is_added_from_nobody_and_from_whoever_has_it(
    client: Client, service: SceneService, fresh_id: str
) -> None:
    truth = _owner(service, fresh_id)
    client.edit_scene(fresh_id, [Edit("discard", object_ids=(2,))])
    before = _owner(service, fresh_id)
    version = client.add_object(fresh_id, turned(0.0), box=(20.0, 13.0, 29.0, 22.0), name="ball")
    after, (new,) = _owner(service, fresh_id), version.prompted
    assert new.views[0] == "" and new.gaussian_count == (after == new.object_id).sum()
    np.testing.assert_array_equal(after[after != new.object_id], before[after != new.object_id])
    assert ((after == new.object_id) & (truth == 2)).sum() >= 0.85 * (truth == 2).sum()
    assert client.query(fresh_id, "ball")[0].object_ids == (new.object_id,)
    client.undo_edit(fresh_id)
    client.undo_edit(fresh_id)
    client.edit_scene(fresh_id, [_MERGE])
    (new,) = client.add_object(fresh_id, "front.png", pixels=[_BALL]).prompted
    taken = _owner(service, fresh_id) == new.object_id
    assert ((truth == 2) & taken).sum() >= 0.85 * max(taken.sum(), (truth == 2).sum())


def test_a_large_view_is_segmented_smaller_at_the_same_place(api_settings: Settings, fresh_id: str) -> None:
    prompts = PromptOptions(max_side=64, views=1)
    small = turned(0.0)
    with open_service(api_settings.model_copy(update={"prompts": prompts})) as service:
        truth = _owner(service, fresh_id)
        for factor in (2, 3):
            large = replace(small, camera=small.camera.scaled_to(48 * factor, 36 * factor))
            place = tuple(factor * side for side in _BALL)
            service.versions.edit(fresh_id, [_MERGE])
            split = replace(_SPLIT, prompt=_prompt(place, view=None, camera=large))
            (new,) = service.versions.edit(fresh_id, [split]).prompted
            piece = _owner(service, fresh_id) == new.object_id
            assert new.views == ("",) and ((truth == 2) & piece).sum() >= 0.85 * max(piece.sum(), (truth == 2).sum())
            edge = Pixel(np.nextafter(48.0 * factor, 0), np.nextafter(36.0 * factor, 0))
            with pytest.raises(InvalidInputError, match="the pixel shows"):
                service.versions.edit(fresh_id, [replace(split, prompt=replace(split.prompt, pixels=(edge,)))])
            service.versions.undo(fresh_id)
            service.versions.undo(fresh_id)


@pytest.mark.parametrize(
    ("edit", "error", "field"),
    [
        (replace(_SPLIT, prompt=None), InvalidInputError, "prompt"),
        (replace(_ADD, prompt=None), InvalidInputError, "prompt"),
        (replace(_MERGE, prompt=_prompt(_BALL)), InvalidInputError, "prompt"),
        (replace(_SPLIT, object_ids=()), InvalidInputError, "label"),
        (replace(_SPLIT, object_ids=(1, 3)), InvalidInputError, "object_ids"),
        (replace(_SPLIT, object_ids=(9,)), NotFoundError, "object_ids[0]"),
        (replace(_ADD, object_ids=(1,)), InvalidInputError, "object_ids"),
        (replace(_SPLIT, prompt=_prompt()), InvalidInputError, "prompt.pixels"),
        (replace(_SPLIT, prompt=_prompt(_BALL, view=None)), InvalidInputError, "prompt.view"),
        (replace(_SPLIT, prompt=_prompt(_BALL, view="none.png")), NotFoundError, "prompt.view"),
        (replace(_SPLIT, prompt=_prompt(_BALL, camera=turned(0.0))), InvalidInputError, "prompt.view"),
        (replace(_SPLIT, prompt=_prompt((48.0, 3.0))), InvalidInputError, "prompt.pixels[0]"),
        (replace(_SPLIT, prompt=_prompt(_BALL, (5.0, -1.0))), InvalidInputError, "prompt.pixels[1]"),
        (replace(_SPLIT, prompt=_prompt(_BALL, background=(Pixel(5, 36),))), InvalidInputError, "prompt.background[0]"),
        (replace(_SPLIT, prompt=_prompt(*[_BALL] * 1000)), LimitExceededError, "prompt.pixels"),
        (
            replace(_SPLIT, prompt=_prompt(_BALL, background=(Pixel(1, 1),) * 64)),
            LimitExceededError,
            "prompt.background",
        ),
        (replace(_SPLIT, prompt=_prompt(box=PixelBox(9, 9, 9, 20))), InvalidInputError, "prompt.box"),
        (replace(_SPLIT, prompt=_prompt(box=PixelBox(9, 9, 90, 20))), InvalidInputError, "prompt.box"),
        (replace(_SPLIT, prompt=_prompt(_NOTHING)), InvalidInputError, "prompt.pixels[0]"),
        (replace(_SPLIT, prompt=_prompt((32.5, 18.5))), InvalidInputError, "prompt.pixels[0]"),
        (replace(_SPLIT, prompt=_prompt(box=PixelBox(0, 0, 5, 5))), InvalidInputError, "prompt"),
        (replace(_ADD, prompt=_prompt(_NOTHING)), InvalidInputError, "prompt"),
        (replace(_SPLIT, name=""), InvalidInputError, "name"),
        (replace(_SPLIT, aliases=("moon",)), InvalidInputError, "aliases"),
        (replace(_SPLIT, color=None, label="mug"), InvalidInputError, "label"),
    ],
)
def test_bad_prompts_are_refused_and_leave_no_version(
    service: SceneService, fresh_id: str, edit: Edit, error: type[FastSplatError], field: str
) -> None:
    with pytest.raises(error) as raised:
        service.versions.edit(fresh_id, (_MERGE, edit))
    assert raised.value.field == f"edits[1].{field}" and type(raised.value) is error and raised.value.hint
    assert len(service.versions.all(fresh_id)) == 1


def test_what_a_person_named_is_cut_only_by_who_has_seen_the_name(client: Client, fresh_id: str) -> None:
    client.edit_scene(fresh_id, [_MERGE])
    named = client.name_objects(fresh_id, 1, "violin")
    for call in (
        lambda seen: client.split_object(fresh_id, 1, "front.png", pixels=[_BALL], looked_at=seen),
        lambda seen: client.edit_scene(fresh_id, [Edit("merge", object_ids=(3, 1)), _BOTH], looked_at=seen),
    ):
        with pytest.raises(ConflictError) as raised:
            call("1")
        assert raised.value.field == "edits[0].version"
        assert call(named.version).current
        client.undo_edit(fresh_id)


_BOTH = Edit("split", object_ids=(3,), prompt=_prompt(_BALL))


def test_a_segmenter_that_is_not_installed_says_how_to_get_it(
    service: SceneService, api_settings: Settings, fresh_id: str
) -> None:
    perception = api_settings.perception.model_copy(update={"segmenter": "mobile_sam"})
    with open_service(api_settings.model_copy(update={"perception": perception})) as without:
        with pytest.raises(ModelUnavailableError) as raised:
            without.versions.edit(fresh_id, [_MERGE, _SPLIT])
        assert "models pull mobile_sam" in raised.value.hint
        assert without.versions.edit(fresh_id, [_MERGE]).current and without.versions._context.memory.cached_bytes == 0


def test_the_segmenter_stays_open_until_others_need_its_memory(api_settings: Settings, fresh_id: str) -> None:
    calls = api_settings.calls.model_copy(update={"answer_memory_bytes": 3 << 30, "request_memory_bytes": 2 << 30})
    with open_service(api_settings.model_copy(update={"calls": calls})) as service:
        service.versions.edit(fresh_id, [_MERGE, _SPLIT])
        warm, memory = service.versions._prompted._segmenters, service._context.memory
        (first,) = warm._slots.values()
        assert memory.cached_bytes == warm.budget == warm.bytes and memory.reserved == 0
        service.versions.edit(fresh_id, [Edit("merge", object_ids=(1, 4)), _SPLIT])
        assert [*warm._slots.values()] == [first] and memory.cached_bytes == warm.budget
        assert service.in_project("another").versions._prompted is service.versions._prompted
        with memory.reserve(2 << 30, "edits"), memory.reserve((1 << 30) - 1, "edits"):
            assert not len(warm) and memory.cached_bytes == 0
            assert not memory.keep(2, warm.release)
        service.versions.undo(fresh_id)
