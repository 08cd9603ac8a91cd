"""Codes of objects: what a pixel shows is what its composited code says, before and after objects are changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.instances.scene_objects import find_scene_objects
from fastsplat.service.perception.label_maps.capture_masks import propose_view_masks
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import Scene, SemanticHead
from fastsplat.service.scene.objects.new_objects import with_new_object
from fastsplat.service.scene.objects.object_codes import classes_of_codes, codes_of_objects
from fastsplat.service.scene.objects.objects import discard_object, merge_objects, object_rows
from fastsplat.service.splatting.labels.blending import object_map
from tests.instances.made_room import ColorSegmenter, NoDetector, Room

_PERCEPTION = PerceptionSettings(min_pixels=8, closer_look=False)


@pytest.fixture(scope="module")
def scene(room: Room) -> Scene:
    """The room with objects that were found in every second view."""
    masks = propose_view_masks(room.capture.views, NoDetector(), ColorSegmenter(), _PERCEPTION)
    seen = tuple(view_masks if number % 2 else None for number, view_masks in enumerate(masks))
    settings = DiscoverySettings(min_weight_px=5)
    objects, gaussians = find_scene_objects(room.gaussians, room.capture, Labelling(Dictionary(()), ()), seen, settings)
    code = gaussians.codes.shape[1]
    return Scene(
        gaussians,
        SemanticHead.unlearnt(0, code),
        Dictionary(()),
        np.zeros((0, 4), np.float32),
        ("none", "0" * 64),
        tuple(view.posed for view in room.capture.views),
        "ARBITRARY",
        objects=objects,
    )


def _maps(scene: Scene) -> np.ndarray:
    return np.stack([object_map(scene, posed) for posed in scene.cameras])


def _ious(maps: np.ndarray, room: Room) -> list[float]:
    """Of each true object, over all views, with the object that overlaps it best."""
    truth = np.stack(room.maps)
    return [
        max(
            ((truth == true) & (maps == object_id)).sum() / ((truth == true) | (maps == object_id)).sum()
            for object_id in np.unique(maps[maps > 0])
        )
        for true in range(1, 5)
    ]


def test_codes_say_whose_a_gaussian_is_and_draw_objects_in_views_nobody_masked(scene: Scene, room: Room) -> None:
    assert scene.objects is not None and scene.objects.head is not None
    owner = object_rows(scene.objects)
    said = classes_of_codes(scene.gaussians.codes, scene.objects.head)[0]
    assert (said == owner)[owner > 0].mean() > 0.97
    coded = _ious(_maps(scene), room)
    counted = _ious(_maps(replace(scene, objects=replace(scene.objects, head=None))), room)
    assert min(coded) > 0.8 and np.mean(coded) >= np.mean(counted) - 0.005


def test_names_merged_and_discarded_objects_change_no_pixel_of_others(scene: Scene) -> None:
    assert scene.objects is not None
    before, (first, second, third) = _maps(scene), [obj.id for obj in scene.objects.table[:3]]
    merged = _maps(merge_objects(scene, [first, second]))
    assert (merged == np.where(before == second, first, before)).all()
    discarded = _maps(discard_object(scene, third))
    assert (discarded == np.where(before == third, 0, before)).all()


def test_an_object_cut_out_of_another_is_drawn_where_its_gaussians_are(scene: Scene) -> None:
    assert scene.objects is not None
    before, owner = _maps(scene), object_rows(scene.objects)
    whole = int(np.bincount(owner[owner > 0]).argmax())
    inside = owner == whole
    middle = np.median(scene.gaussians.means[inside, 0])
    for half in (scene.gaussians.means[:, 0] > middle, scene.gaussians.means[:, 0] <= middle):
        cut, new = with_new_object(scene, np.flatnonzero(inside & half))
        after = _maps(cut)
        assert cut.objects is not None
        bare = _maps(replace(cut, objects=replace(cut.objects, head=None)))
        for obj in (whole, new):
            overlap = ((after == obj) & (bare == obj)).sum() / ((after == obj) | (bare == obj)).sum()
            assert overlap > 0.85
        rest = (before != whole) & (before != 0)
        assert (after[rest] == before[rest]).mean() > 0.98


def test_rows_without_a_code_take_no_class_from_others() -> None:
    head = SemanticHead(6 * np.eye(3, dtype=np.float32), np.array([0, 0.1, 0], np.float32))
    codes = np.concatenate([np.eye(3, dtype=np.float32)[[1, 1, 2]], np.zeros((9, 3), np.float32)])
    owner = np.array([5, 5, 8] + [9] * 9, np.int32)  # nine Gaussians that came from another scene
    coded = codes_of_objects(codes, head, owner)
    assert coded.ids.tolist() == [0, 5, 8, 9]
    assert (coded.ids[classes_of_codes(coded.codes, coded.head)[0]] == owner).all()
    same = codes_of_objects(codes[:3], head, owner[:3])
    assert (same.codes == codes[:3]).all() and same.ids.tolist() == [0, 5, 8]
