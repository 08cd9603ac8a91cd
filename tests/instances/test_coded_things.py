"""Codes of things: what a pixel shows is what its composited code says, before and after things are changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.instances.scene_things import find_scene_things
from fastsplat.service.perception.label_maps.capture_masks import propose_view_masks
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import Scene, SemanticHead
from fastsplat.service.scene.objects.new_things import with_new_thing
from fastsplat.service.scene.objects.thing_codes import classes_of_codes, codes_of_things
from fastsplat.service.scene.objects.things import discard_thing, merge_things, thing_rows
from fastsplat.service.splatting.labels.blending import thing_map
from tests.instances.made_room import ColorSegmenter, NoDetector, Room

_PERCEPTION = PerceptionSettings(min_pixels=8, closer_look=False)


@pytest.fixture(scope="module")
def scene(room: Room) -> Scene:
    """The room with things that were found in every second view."""
    masks = propose_view_masks(room.capture.views, NoDetector(), ColorSegmenter(), _PERCEPTION)
    seen = tuple(own if number % 2 else None for number, own in enumerate(masks))
    settings = DiscoverySettings(min_weight_px=5)
    things, gaussians = find_scene_things(room.gaussians, room.capture, Labelling(Dictionary(()), ()), seen, settings)
    code = gaussians.codes.shape[1]
    return Scene(
        gaussians,
        SemanticHead.unlearnt(0, code),
        Dictionary(()),
        np.zeros((0, 4), np.float32),
        ("none", "0" * 64),
        tuple(view.posed for view in room.capture.views),
        "ARBITRARY",
        things=things,
    )


def _maps(scene: Scene) -> np.ndarray:
    return np.stack([thing_map(scene, posed) for posed in scene.cameras])


def _ious(maps: np.ndarray, room: Room) -> list[float]:
    """Of each true thing, over all views, with the thing that overlaps it best."""
    truth = np.stack(room.maps)
    return [
        max(
            ((truth == true) & (maps == own)).sum() / ((truth == true) | (maps == own)).sum()
            for own in np.unique(maps[maps > 0])
        )
        for true in range(1, 5)
    ]


def test_codes_say_whose_a_gaussian_is_and_draw_things_in_views_nobody_masked(scene: Scene, room: Room) -> None:
    assert scene.things is not None and scene.things.head is not None
    owner = thing_rows(scene.things)
    said = classes_of_codes(scene.gaussians.codes, scene.things.head)[0]
    assert (said == owner)[owner > 0].mean() > 0.97
    coded = _ious(_maps(scene), room)
    counted = _ious(_maps(replace(scene, things=replace(scene.things, head=None))), room)
    assert min(coded) > 0.8 and np.mean(coded) >= np.mean(counted) - 0.005


def test_names_merged_and_discarded_things_change_no_pixel_of_others(scene: Scene) -> None:
    assert scene.things is not None
    before, (first, second, third) = _maps(scene), [thing.id for thing in scene.things.table[:3]]
    merged = _maps(merge_things(scene, [first, second]))
    assert (merged == np.where(before == second, first, before)).all()
    discarded = _maps(discard_thing(scene, third))
    assert (discarded == np.where(before == third, 0, before)).all()


def test_a_thing_cut_out_of_another_is_drawn_where_its_gaussians_are(scene: Scene) -> None:
    assert scene.things is not None
    before, owner = _maps(scene), thing_rows(scene.things)
    whole = int(np.bincount(owner[owner > 0]).argmax())
    inside = owner == whole
    middle = np.median(scene.gaussians.means[inside, 0])
    for half in (scene.gaussians.means[:, 0] > middle, scene.gaussians.means[:, 0] <= middle):
        cut, new = with_new_thing(scene, np.flatnonzero(inside & half))
        after = _maps(cut)
        assert cut.things is not None
        bare = _maps(replace(cut, things=replace(cut.things, head=None)))
        for thing in (whole, new):
            overlap = ((after == thing) & (bare == thing)).sum() / ((after == thing) | (bare == thing)).sum()
            assert overlap > 0.85
        others = (before != whole) & (before != 0)
        assert (after[others] == before[others]).mean() > 0.98


def test_rows_without_a_code_take_no_class_from_others() -> None:
    head = SemanticHead(6 * np.eye(3, dtype=np.float32), np.array([0, 0.1, 0], np.float32))
    codes = np.concatenate([np.eye(3, dtype=np.float32)[[1, 1, 2]], np.zeros((9, 3), np.float32)])
    owner = np.array([5, 5, 8] + [9] * 9, np.int32)  # nine Gaussians that came from another scene
    coded = codes_of_things(codes, head, owner)
    assert coded.ids.tolist() == [0, 5, 8, 9]
    assert (coded.ids[classes_of_codes(coded.codes, coded.head)[0]] == owner).all()
    same = codes_of_things(codes[:3], head, owner[:3])
    assert (same.codes == codes[:3]).all() and same.ids.tolist() == [0, 5, 8]
