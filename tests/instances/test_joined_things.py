"""Photos that join a scene: what they alone show is a thing of its own; names of people and all that they do not show
stay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.common.dictionary import Dictionary, dictionary_of
from fastsplat.service.instances.joined_views import _codes
from fastsplat.service.instances.scene_things import find_scene_things
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.joined_things import with_joined_things
from fastsplat.service.perception.capture_masks import propose_view_masks
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.perception.types import Labelling, Regions
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.label_evidence import rows_of
from fastsplat.service.scene.scene_rows import scene_of_rows
from fastsplat.service.scene.things import discard_thing, next_thing_id, rename_thing, thing_rows
from fastsplat.service.scene.types import Scene, SemanticHead
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.blending import thing_map
from tests.instances.made_room import ColorSegmenter, NoDetector, Room, make_room

_BLUE = 3
_NEW, _OTHER = (5, 6, 7), 2
"""Views that join, and one that does not."""


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Room:
    return make_room(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="module")
def masks(room: Room) -> tuple:
    perception = PerceptionSettings(min_pixels=8, closer_look=False)
    return propose_view_masks(room.capture.views, NoDetector(), ColorSegmenter(), perception)


@pytest.fixture(scope="module")
def settings(models_dir: Path) -> Settings:
    return Settings(models=models_dir, discovery=DiscoverySettings(min_weight_px=5))


@pytest.fixture(scope="module")
def whole(room: Room, masks: tuple, settings: Settings) -> Scene:
    """The room with its four things, none of which has a name."""
    unnamed = Labelling(Dictionary(()), ())
    things, gaussians = find_scene_things(room.gaussians, room.capture, unnamed, masks, settings.discovery)
    encoder = open_text_encoder("minilm_l6_int8", settings.models)
    return Scene(
        gaussians,
        SemanticHead.unlearnt(0, gaussians.codes.shape[1]),
        Dictionary(()),
        np.zeros((0, len(encoder.encode(["a"])[0])), np.float32),
        (encoder.name, encoder.sha256),
        tuple(view.posed for view in room.capture.views if view is not room.capture.views[_OTHER]),
        "METRIC",
        things=things,
    )


def _thing(scene: Scene, rows: np.ndarray) -> int:
    assert scene.things is not None
    return int(np.bincount(thing_rows(scene.things)[rows]).argmax())


def _with_born(scene: Scene, born: np.ndarray) -> tuple[Scene, np.ndarray, np.ndarray]:
    """The scene in which the Gaussians `born`, bool [G], are the last and belong to whatever is nearest to them; which
    they are, and which row of `scene` each is now."""
    order = np.concatenate([np.flatnonzero(~born), np.flatnonzero(born)])
    made = scene_of_rows(scene, order)
    assert made.things is not None
    count, means = int((~born).sum()), made.gaussians.means
    distances = np.linalg.norm(means[count:, None] - means[None, :count], axis=2)
    nearest = np.concatenate([np.arange(count), distances.argmin(axis=1)])
    things = replace(made.things, membership=rows_of(made.things.membership, nearest))
    codes = np.ascontiguousarray(made.gaussians.codes[nearest])
    made = replace(made, things=things, gaussians=replace(made.gaussians, codes=codes))
    return made, np.arange(len(order)) >= count, order


def _called(room: Room, masks: tuple, name: str) -> Labelling:
    """The views that join, in which blue areas are called so."""
    maps = [np.where(room.maps[number] == _BLUE + 1, 1, 0).astype(np.uint16) for number in _NEW]
    regions = tuple(Regions(blue, (((1, 0.95),),)) for blue in maps)
    return Labelling(dictionary_of([name]), tuple(maps), False, regions, tuple(masks[number] for number in _NEW))


def test_what_new_photos_alone_show_becomes_a_thing_and_all_else_stays(
    whole: Scene, room: Room, masks: tuple, settings: Settings
) -> None:
    red, blue = (_thing(whole, room.owner == number) for number in (1, _BLUE))
    before = discard_thing(rename_thing(whole, red, "Anna's ball"), blue)
    before, born, order = _with_born(before, room.owner == _BLUE)
    changed = born | (before.gaussians.means[:, 0] > 0)
    assert not changed[room.owner[order] == 1].any()
    views = tuple(room.capture.views[number] for number in _NEW)
    after = with_joined_things(before, views, _called(room, masks, "cup"), changed, born, settings)
    assert before.things is not None and after.things is not None
    (new,) = (thing for thing in after.things.table if thing.id not in {each.id for each in before.things.table})
    assert new.id == next_thing_id(before.things) and (new.name, new.source) == ("cup", "detected")
    assert new.appearance and set(new.proposed_in) <= {4, 5, 6} and new.consensus > 0.5
    owner = thing_rows(after.things)
    assert (owner[born] == new.id).mean() > 0.8 and (owner == new.id)[~born].sum() <= 5
    named = next(thing for thing in after.things.table if thing.id == red)
    assert (named.name, named.source) == ("Anna's ball", "person")
    shown, true = thing_map(after, room.capture.views[_OTHER].posed) == new.id, room.maps[_OTHER] == _BLUE + 1
    assert (shown & true).sum() > 0.75 * (shown | true).sum()
    # What the photos do not show has its codes and its evidence, to the bit.
    rows = np.flatnonzero(~changed)
    for name in ("starts", "labels", "counts"):
        own, same = (getattr(rows_of(each.things.membership, rows), name) for each in (before, after))
        assert np.array_equal(own, same), name
    assert np.array_equal(before.gaussians.codes[~changed], after.gaussians.codes[~changed])
    assert after.gaussians.means is before.gaussians.means
    # It can be asked, by a name that the scene has learnt.
    assert after.dictionary.id_of("cup") is not None and after.label_embeddings.shape[0] == len(after.dictionary)
    index = SceneIndex(after, open_text_encoder("minilm_l6_int8", settings.models), settings.query)
    assert new.id in {thing.id for thing in index.things.listed if thing.name == "cup"}


@pytest.mark.parametrize("beyond", [0.4, -0.4])
def test_more_of_a_known_thing_is_that_thing(
    whole: Scene, room: Room, masks: tuple, settings: Settings, beyond: float
) -> None:
    """Also where most of it is new."""
    more = (room.owner == 0) & (room.gaussians.means[:, 0] > beyond)
    before, born, _ = _with_born(whole, more)
    changed = np.ones(len(born), np.bool_)
    views = tuple(room.capture.views[number] for number in _NEW)
    after = with_joined_things(before, views, _called(room, masks, "cup"), changed, born, settings)
    assert before.things is not None and after.things is not None
    assert [thing.id for thing in after.things.table] == [thing.id for thing in before.things.table]
    floor = _thing(whole, room.owner == 0)
    assert (thing_rows(after.things)[born] == floor).mean() > 0.95
    # What three of seven views call a thing that four others saw without a word is not its name yet.
    blue = next(thing for thing in after.things.table if thing.id == _thing(whole, room.owner == _BLUE))
    assert len(blue.proposed_in) + len(blue.missed_in) > 8
    assert [each.name for each in blue.suggestions] == ["cup"] and not blue.name


def test_photos_that_nobody_looked_at_say_nothing(whole: Scene, room: Room, settings: Settings) -> None:
    views = tuple(room.capture.views[number] for number in _NEW)
    blank = tuple(np.zeros_like(room.maps[number]) for number in _NEW)
    regions = tuple(Regions(own, ()) for own in blank)
    silent = Labelling(Dictionary(()), blank, regions=regions, masks=(None, None, None))
    none = np.zeros(len(whole.gaussians), np.bool_)
    after = with_joined_things(whole, views, silent, ~none, none, settings)
    assert after.things == whole.things and after.gaussians is whole.gaussians


def test_what_moves_to_another_thing_has_the_mean_code_of_what_was_that_thing_before() -> None:
    codes = np.random.default_rng(0).normal(size=(6, 2)).astype(np.float32)
    before, after = np.array([1, 1, 2, 2, 0, 1]), np.array([1, 2, 2, 2, 2, 3])
    born = np.array([False, False, False, True, False, False])
    made = _codes(codes, before, after, after != before, born)
    assert np.allclose(made[[1, 4]], codes[2])  # 3 was born: it learns its own code
    assert np.array_equal(made[[0, 2, 3, 5]], codes[[0, 2, 3, 5]])  # nothing was 3 before
