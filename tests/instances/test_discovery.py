"""Objects of a made room are discovered without a word, and named by whoever has words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat.service.capture.build import load_image
from fastsplat.service.common.dictionary import Dictionary, dictionary_of
from fastsplat.service.instances.discovery.discovery import Discovery, discover_objects
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.instances.naming.name_models import default_name_model
from fastsplat.service.instances.naming.naming import (
    NAMED_FROM,
    NameVotes,
    name_objects,
    name_probability,
)
from fastsplat.service.instances.naming.object_appearances import with_appearances
from fastsplat.service.instances.scene_objects import find_scene_objects, regions_of_label_map
from fastsplat.service.perception.appearance import SIZE, open_appearance_encoder
from fastsplat.service.perception.image_text import open_image_text
from fastsplat.service.perception.label_maps.capture_masks import propose_view_masks
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling, Regions, ViewMasks
from fastsplat.service.scene.artefact.scene import STATED_FROM, Gaussians, Object, Objects
from fastsplat.service.scene.objects.label_evidence import no_evidence
from fastsplat.service.scene.objects.objects import object_rows
from fastsplat_contract.errors import CancelledError
from tests.instances.made_room import NAMES, BallDetector, ColorSegmenter, NoDetector, Room
from tests.looks_model import MODEL, write_looks_model

SETTINGS = DiscoverySettings(min_weight_px=5)
UP = np.array([0.0, 0.0, 1.0])
MEASURED = default_name_model()
PERCEPTION = PerceptionSettings(min_pixels=8, closer_look=False)

Masks = tuple[ViewMasks | None, ...]
Found = tuple[Objects, Gaussians]


@pytest.fixture(scope="module")
def masks(room: Room) -> Masks:
    return propose_view_masks(room.capture.views, NoDetector(), ColorSegmenter(), PERCEPTION)


@pytest.fixture(scope="module")
def discovery(room: Room, masks: Masks) -> Discovery:
    return discover_objects(room.gaussians, room.capture.views, masks, UP, SETTINGS)


def _overlaps(objects: Objects, owner: np.ndarray) -> dict[int, tuple[int, float]]:
    """Of each true object, the object that overlaps it most, and by how much."""
    rows = object_rows(objects)
    best = {}
    for true in range(4):
        inside = owner == true
        shares = {
            obj.id: (inside & (rows == obj.id)).sum() / (inside | (rows == obj.id)).sum() for obj in objects.table
        }
        best[true] = max(shares.items(), key=lambda item: item[1])
    return best


def test_every_object_is_discovered_once(room: Room, discovery: Discovery) -> None:
    best = _overlaps(discovery.objects, room.owner)
    assert len(discovery.objects.table) == 4 and len({obj for obj, _ in best.values()}) == 4
    # Half of each ball's points look down or lie within; of those no view says anything.
    assert all(overlap > 0.6 for _, overlap in best.values())
    assert all(not obj.name and obj.source is None for obj in discovery.objects.table)
    assert [obj.id for obj in discovery.objects.table] == [1, 2, 3, 4]
    assert all(obj.consensus > 0.5 for obj in discovery.objects.table)


def test_the_floor_is_a_surface_and_balls_are_none(room: Room, discovery: Discovery) -> None:
    best = _overlaps(discovery.objects, room.owner)
    kinds = {obj.id: obj.surface for obj in discovery.objects.table}
    assert kinds[best[0][0]] == "horizontal surface"
    assert all(kinds[best[ball][0]] == "" for ball in (1, 2, 3))


def test_views_that_nobody_looked_at_have_no_say(room: Room) -> None:
    few = propose_view_masks(
        room.capture.views, NoDetector(), ColorSegmenter(), PERCEPTION.model_copy(update={"proposal_views": 5})
    )
    assert sum(masks is not None for masks in few) == 5 and few[0] is not None and few[-1] is not None
    all_views = discover_objects(room.gaussians, room.capture.views, few, UP, SETTINGS)
    used = [(view, masks) for view, masks in zip(room.capture.views, few, strict=True) if masks is not None]
    alone = discover_objects(room.gaussians, [view for view, _ in used], [masks for _, masks in used], UP, SETTINGS)
    assert all_views.views == 5 and (object_rows(all_views.objects) == object_rows(alone.objects)).all()


def test_boxes_spare_points(room: Room) -> None:
    """What the answer to a box explains is prompted once more at most, whatever the box is called."""
    boxes, points = ColorSegmenter(), ColorSegmenter()
    with_boxes = propose_view_masks(room.capture.views[:1], BallDetector(), boxes, PERCEPTION)[0]
    without = propose_view_masks(room.capture.views[:1], NoDetector(), points, PERCEPTION)[0]
    assert with_boxes is not None and without is not None
    assert with_boxes.prompts == boxes.prompts[0] and without.prompts == points.prompts[0]
    balls = len(BallDetector().detect(load_image(room.capture.views[0]), 0.0))
    assert balls == 3 and with_boxes.prompts - balls == len(boxes.pointed_at)
    assert max(len(boxes.pointed_at), len(points.pointed_at)) <= PERCEPTION.proposal_points
    assert all(boxes.pointed_at.count(ball) <= 1 for ball in (2, 3, 4)) and set(points.pointed_at) >= {2, 3, 4}
    assert len(with_boxes) >= len(without)


def test_the_same_input_gives_the_same_objects(room: Room, discovery: Discovery, masks: Masks) -> None:
    again = discover_objects(room.gaussians, room.capture.views, masks, UP, SETTINGS)
    assert again.objects.table == discovery.objects.table
    assert (object_rows(again.objects) == object_rows(discovery.objects)).all()


def test_it_ends_when_asked_to(room: Room, masks: Masks) -> None:
    def stop(done: int, total: int) -> None:
        assert 1 <= done <= total == 8
        if done == 2:
            raise CancelledError("enough")

    with pytest.raises(CancelledError):
        discover_objects(room.gaussians, room.capture.views, masks, UP, SETTINGS, stop)


def test_no_views_no_objects(room: Room) -> None:
    discovery = discover_objects(room.gaussians, (), (), UP, SETTINGS)
    assert discovery.objects.table == () and discovery.prompts == 0
    assert (object_rows(discovery.objects) == 0).all()


def test_given_label_maps_name_what_they_show(room: Room, masks: Masks) -> None:
    labelling = Labelling(dictionary_of(NAMES), room.maps, exact=True)
    objects, _ = find_scene_objects(room.gaussians, room.capture, labelling, masks, SETTINGS)
    names = {obj.id: (obj.name, obj.source) for obj in objects.table}
    for true, (obj, _) in _overlaps(objects, room.owner).items():
        assert names[obj] == (NAMES[true], "given")


@pytest.fixture(scope="module")
def unnamed(room: Room, masks: Masks) -> Found:
    """The objects of the room without labels, and its Gaussians."""
    return find_scene_objects(room.gaussians, room.capture, Labelling(Dictionary(()), ()), masks, SETTINGS)


def test_objects_are_described_from_the_photos_that_show_them(room: Room, unnamed: Found, models_dir: Path) -> None:
    encoder = open_appearance_encoder(PerceptionSettings(), models_dir)
    assert encoder is not None
    objects, gaussians = unnamed
    described = with_appearances(objects, gaussians, room.capture.views, encoder, SETTINGS.max_side)
    best = _overlaps(objects, room.owner)
    for obj in described.table:
        descriptor = np.frombuffer(obj.appearance, np.float16)
        assert descriptor.shape == (SIZE,) and np.linalg.norm(descriptor.astype(np.float64)) == pytest.approx(
            1, abs=0.01
        )
    blue_green_red = {}
    for number in (1, 2, 3):
        (obj,) = [obj for obj in described.table if obj.id == best[number][0]]
        picture = cv2.imdecode(np.frombuffer(obj.picture, np.uint8), cv2.IMREAD_COLOR)
        blue_green_red[number] = int(picture[40:56, 40:56].reshape(-1, 3).mean(axis=0).argmax())
    assert blue_green_red == {1: 2, 2: 1, 3: 0}
    assert with_appearances(objects, gaussians, (), encoder, SETTINGS.max_side) == objects


def test_an_image_text_model_looks_at_the_photos_that_show_an_object_best(
    room: Room, unnamed: Found, tmp_path: Path
) -> None:
    write_looks_model(tmp_path)
    model = open_image_text(PerceptionSettings(image_text=MODEL), tmp_path)
    objects, gaussians = unnamed
    looked = with_appearances(objects, gaussians, room.capture.views, None, SETTINGS.max_side, looks=model)
    assert not any(obj.appearance or obj.picture for obj in looked.table)
    looks = {obj.id: obj.looks for obj in looked.table if obj.looks is not None}
    assert {look.sha256 for look in looks.values()} == {model.sha256}
    best, words = _overlaps(objects, room.owner), model.encode(["red", "green", "blue"])
    rows = np.stack([np.frombuffer(looks[best[number][0]].embedding, np.float16) for number in (1, 2, 3)])
    assert np.linalg.norm(rows.astype(np.float64), axis=1) == pytest.approx(1, abs=0.01)
    assert (rows @ words.T).argmax(axis=1).tolist() == [0, 1, 2]


def test_a_detector_that_is_of_two_minds_only_suggests(room: Room, masks: Masks) -> None:
    """Of the red ball every other view says "ball" and the rest "apple"; of the blue one all say "orange"."""
    regions = []
    for number, label_map in enumerate(room.maps):
        ids = np.zeros(label_map.shape, np.uint16)
        ids[label_map == 2], ids[label_map == 4] = 1, 2
        regions.append(Regions(ids, (((1 + number % 2, 0.9),), ((3, 0.8),))))
    maps = tuple(np.zeros_like(label_map) for label_map in room.maps)
    labelling = Labelling(dictionary_of(("ball", "apple", "orange")), maps, regions=tuple(regions))
    found = find_scene_objects(room.gaussians, room.capture, labelling, masks, SETTINGS, name_model=MEASURED)
    objects, _ = found
    by_id = {obj.id: obj for obj in objects.table}
    best = _overlaps(objects, room.owner)
    red, blue, green = (by_id[best[number][0]] for number in (1, 3, 2))
    assert red.name == "" and {guess.name for guess in red.suggestions} == {"ball", "apple"}
    assert blue.name == "orange" and blue.source == "detected" and blue.probability >= NAMED_FROM
    assert green.name == "" and green.suggestions == ()
    doubted, _ = find_scene_objects(room.gaussians, room.capture, labelling, masks, SETTINGS)
    assert not any(obj.name for obj in doubted.table) and any(obj.suggestions for obj in doubted.table)


def test_a_name_by_a_person_outlives_votes() -> None:
    objects = Objects((Object(1, "Fritz", "person", 1.0), Object(2)), no_evidence(3))
    votes = NameVotes(np.array([[0.0, 5.0], [0.0, 5.0]]), np.array([5.0, 5.0]))
    named = name_objects(objects, votes, ("cup",), "detected", MEASURED)
    assert [obj.name for obj in named.table] == ["Fritz", "cup"]


@settings(max_examples=50)
@given(st.lists(st.floats(0, 10), min_size=4, max_size=4), st.floats(1, 10))
def test_stated_names_are_clear_and_probabilities_are_such(scores: list[float], able: float) -> None:
    votes = NameVotes(np.array([[0.0, *scores]]), np.array([able]))
    objects = Objects((Object(1),), no_evidence(3))
    (obj,) = name_objects(objects, votes, ("a", "b", "c", "d"), "detected", MEASURED).table
    probability = name_probability(votes.mean_scores, ("a", "b", "c", "d"), MEASURED)[0, 1:]
    assert bool(obj.name) == (probability.max() >= NAMED_FROM)
    if obj.name:
        assert obj.probability == pytest.approx(probability.max())
        assert obj.guessed == (obj.probability < STATED_FROM)
    shares = [guess.probability for guess in obj.suggestions]
    assert shares == sorted(shares, reverse=True) and obj.name not in {guess.name for guess in obj.suggestions}


def test_regions_of_a_label_map_are_its_connected_areas() -> None:
    label_map = np.zeros((30, 30), np.uint16)
    label_map[2:8, 2:8], label_map[20:28, 20:28], label_map[2:8, 20:26], label_map[15, 15] = 3, 3, 1, 1
    regions = regions_of_label_map(label_map)
    assert sorted(vote[0][0] for vote in regions.votes) == [1, 3, 3]
    for number, votes in enumerate(regions.votes, start=1):
        assert (label_map[regions.ids == number] == votes[0][0]).all()
    assert (regions.ids > 0).sum() == (label_map > 0).sum() - 1  # the speck


def test_an_object_says_in_which_views_it_was_proposed_and_missed(
    room: Room, masks: Masks, discovery: Discovery
) -> None:
    views = range(len(room.capture.views))
    for obj in discovery.objects.table:
        assert set(obj.proposed_in) <= set(views) and len(obj.proposed_in) >= 2
        assert not set(obj.proposed_in) & set(obj.missed_in)
        assert (obj.consensus == 1.0) == (not obj.missed_in)
    # Numbers are those of the capture's views, also where some of these have no say.
    few = discover_objects(room.gaussians, room.capture.views, (None, *masks[1:]), UP, SETTINGS)
    seen = {number for obj in few.objects.table for number in (*obj.proposed_in, *obj.missed_in)}
    assert seen and min(seen) >= 1 and max(seen) == max(views)
    third = masks[3]
    assert third is not None
    blind = (*masks[:3], replace(third, bits=third.bits[:0], quality=third.quality[:0]), *masks[4:])
    best = max(discovery.objects.table, key=lambda obj: len(obj.proposed_in))
    assert 3 in best.proposed_in
    after = discover_objects(room.gaussians, room.capture.views, blind, UP, SETTINGS)
    assert any(3 in obj.missed_in for obj in after.objects.table)
    assert not any(3 in obj.proposed_in for obj in after.objects.table)
