"""A finished scene is looked at again with a real open-vocabulary detector, of evaluation weights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.instances.discovery_settings import LookAgainOptions
from fastsplat.service.jobs.look_again import Sightings, look_for, name_sightings
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.objects.objects import discard_object
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import CancelledError, ModelUnavailableError
from fastsplat_contract.geometry.camera import PosedCamera
from tests.instances.made_table import made_table, measured_detector

_WORDS = {  # what the label table of the development machine calls these
    "red scissors": "scissors", "magnifying glass": "hand glass", "ramekin": "bowl", "cereal box": "carton",
    "soda can": "can", "utensil holder": "canister",
}  # fmt: skip
Table = tuple[SceneIndex, dict[int, str]]
Looked = tuple[Sightings, list[ProgressEvent]]
_DETECTOR = PerceptionSettings(
    open_set_detector="yolo_world:yolo_world_s", prompt_encoder="label_table:clip_text_vocab"
)


@pytest.fixture(scope="module")
def settings(models_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Settings:
    if not (models_dir / "yolo_world_s").is_dir():
        pytest.skip("evaluation weights are not there")
    models = measured_detector(models_dir, tmp_path_factory.mktemp("models"), _DETECTOR.open_set_detector)
    look_again = LookAgainOptions(views=4, closer_views=2)
    return Settings(models=models, perception=_DETECTOR, look_again=look_again)


@pytest.fixture(scope="module")
def table(settings: Settings, test_data: Path) -> Table:
    encoder = open_text_encoder("minilm_l6_int8", settings.models)
    scene, objects = made_table(test_data / "tabletop", range(0, 40, 5), encoder)
    return SceneIndex(scene, encoder), {number: _WORDS.get(name, name) for number, name in objects.items()}


@pytest.fixture(scope="module")
def looked(settings: Settings, table: Table, test_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Looked:
    """A look at the table top's photos for the names of all 14 objects."""
    index, truth = table
    cameras = {posed.name: posed.camera for posed in index.scene.cameras}

    def photo(posed: PosedCamera) -> tuple[np.ndarray, np.ndarray]:
        """The part of the photo that a camera of the same pose sees."""
        whole, part = cameras[posed.name], posed.camera
        x, y = part.fx / whole.fx, part.fy / whole.fy
        shift = np.array([[x, 0, part.cx - x * whole.cx], [0, y, part.cy - y * whole.cy]])
        picture = cv2.imread(str(test_data / "tabletop" / "images" / posed.name))[:, :, ::-1]
        seen = cv2.warpAffine(np.ascontiguousarray(picture), shift, (part.width, part.height))
        return np.asarray(seen, np.uint8), np.ones((part.height, part.width), np.bool_)

    events: list[ProgressEvent] = []
    folder = tmp_path_factory.mktemp("pictures")
    return look_for(index, list(truth.values()), settings, folder, events.append, photo), events


def test_objects_are_named_by_what_was_asked_for(settings: Settings, table: Table, looked: Looked) -> None:
    """A small detector knows few words: five of 14 names are right, a holder is a mug, a screwdriver scissors."""
    index, truth = table
    scene, result = name_sightings(index, looked[0], settings)
    right = [name for name in result.named if label_key(truth[name.object_id]) == label_key(name.name)]
    print(
        f"{len(right)} of {len(result.named)} right",
        [(truth[n.object_id], n.name, n.probability) for n in result.named],
    )
    assert len(right) >= 4 and len(right) >= 0.6 * len(result.named)
    assert scene.objects is not None
    named = {name.object_id for name in result.named}
    for obj in scene.objects.table:
        assert bool(obj.name) == (obj.id in named) and obj.source in ("detected", None)
    (answer,) = index.after(scene).ask([right[0].name])
    assert answer.outcome == "here" and right[0].object_id in answer.object_ids


def test_a_look_says_from_where_and_how_far_it_is(table: Table, looked: Looked) -> None:
    sightings, events = looked
    assert not sightings.rendered and len(sightings.views) == 4
    assert set(sightings.views) <= {posed.name for posed in table[0].scene.cameras}
    fractions = [event.fraction for event in events]
    assert {event.stage for event in events} == {"looking"} and fractions[-1] == 1
    assert fractions == sorted(fractions)
    assert 0 <= sightings.unmatched <= sightings.regions


def test_the_names_that_were_searched_for_grow(settings: Settings, table: Table, looked: Looked) -> None:
    """By those that are new; the absence of anything else is said of all of them."""
    index, _ = table
    scene, _ = name_sightings(index, looked[0], settings)
    assert scene.facts.searched_names == 80 + 14
    for share, outcome in ((0.0, "cannot_say"), (0.4, "not_here")):  # of a detector that is not measured, and measured
        later = replace(looked[0], texts=("Mugs", "trophy"), found={}, found_share=share)
        again, _ = name_sightings(index.after(scene), later, settings)
        (answer,) = index.after(again).ask(["trophy"])
        assert (answer.outcome, answer.searched.names, again.facts.searched_names) == (outcome, 95, 80 + 15)


def test_a_persons_names_stay(settings: Settings, table: Table, looked: Looked) -> None:
    """Also those that were given while the detector looked, and what is gone by then is left out."""
    index, _ = table
    first = next(iter(looked[0].found))
    objects = index.scene.objects
    assert objects is not None
    given = {"name": "grandmother's", "source": "person", "probability": 1.0}
    table = tuple(replace(obj, **given) if obj.id == first else obj for obj in objects.table)
    scene = replace(index.scene, objects=replace(objects, table=table))
    second = next(number for number in looked[0].found if number != first)
    scene = discard_object(scene, second)
    after, result = name_sightings(index.after(scene), looked[0], settings)
    assert after.objects is not None
    named_object = next(obj for obj in after.objects.table if obj.id == first)
    assert (named_object.name, named_object.source, named_object.suggestions) == ("grandmother's", "person", ())
    changed = {name.object_id for name in (*result.named, *result.suggested)}
    assert changed and not changed & {first, second}


def test_a_look_ends_when_its_job_is_cancelled(settings: Settings, table: Table, tmp_path: Path) -> None:
    def stop(event: ProgressEvent) -> None:
        raise CancelledError("enough")

    with pytest.raises(CancelledError):
        look_for(table[0], ["banana"], settings, tmp_path, stop)


@pytest.mark.parametrize(
    "update", [{"open_set_detector": ""}, {"open_set_detector": "yolo_world:nowhere"}, {"segmenter": "sam1:nowhere"}]
)
def test_a_look_without_its_models_fails_before_anything_is_rendered(
    settings: Settings, table: Table, tmp_path: Path, update: dict[str, str]
) -> None:
    bad_settings = settings.model_copy(update={"perception": settings.perception.model_copy(update=update)})
    with pytest.raises(ModelUnavailableError):
        look_for(table[0], ["banana"], bad_settings, tmp_path, lambda event: pytest.fail("it has begun"))
