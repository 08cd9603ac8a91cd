"""A capture in, a dictionary and label maps out: the whole room with real models."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fastsplat.service.capture.captures import GivenLabels
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.common.progress import ProgressEvent, silent
from fastsplat.service.jobs import create_scene
from fastsplat.service.perception.class_names import TAGS
from fastsplat.service.perception.detectors.open_detectors import open_closed_set_detector
from fastsplat.service.perception.detectors.picodet import PicoDet
from fastsplat.service.perception.label_maps import capture_detection
from fastsplat.service.perception.label_maps import labelling as labelling_module
from fastsplat.service.perception.label_maps.capture_detection import CaptureDetector, _prompts
from fastsplat.service.perception.label_maps.labelling import label_capture, views_to_segment
from fastsplat.service.perception.models.model_manifest import is_prompted_by_classes
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Detections, Labelling
from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter
from fastsplat.service.perception.segmenters.sam1 import Sam1
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import CancelledError, InvalidInputError, ModelUnavailableError
from tests.perception.conftest import make_capture, read_rgb

_SETTINGS = PerceptionSettings(threads=1)


@pytest.fixture(scope="module", autouse=True)
def _each_photo_is_looked_at_once() -> Iterator[None]:
    """The same networks say the same of the same photo: what one test has computed serves the others."""
    known: dict[tuple[object, ...], Any] = {}

    def remembered(look: Callable[..., Any]) -> Callable[..., Any]:
        def seen(model: Any, image: np.ndarray, *more: object) -> Any:
            key = (look, image.shape, image.tobytes(), more)
            if key not in known:
                known[key] = look(model, image, *more)
            return known[key]

        return seen

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Sam1, "embed", remembered(Sam1.embed))
        patch.setattr(PicoDet, "detect", remembered(PicoDet.detect))
        yield


def _table_views(test_data: Path, names: list[str]) -> list[Path]:
    return [test_data / "tabletop" / "images" / f"{name}.jpg" for name in names]


def test_named_objects_are_found_and_cut_out(test_data: Path, models_dir: Path) -> None:
    capture = make_capture(_table_views(test_data, ["018", "024"]))
    events: list[ProgressEvent] = []
    labelling = label_capture(capture, _SETTINGS, models_dir, ["Bananas", "orange"], events.append)
    assert {entry.label for entry in labelling.dictionary.entries} == {"Bananas", "orange"}
    ids = json.loads((test_data / "tabletop" / "transforms.json").read_text())["labels"]
    for view, label_map in zip(("018", "024"), labelling.label_maps, strict=True):
        assert label_map.shape == (360, 480) and label_map.dtype == np.uint16
        truth = cv2.imread(str(test_data / "tabletop" / "masks" / f"{view}.png"), cv2.IMREAD_UNCHANGED)
        for label in ("banana", "orange"):
            mask, true_mask = label_map == labelling.dictionary.id_of(label), truth == ids[label]
            assert (mask & true_mask).sum() / (mask | true_mask).sum() > 0.75
    fractions = [event.fraction for event in events]
    assert fractions == sorted(fractions) and fractions[-1] == 1
    assert {event.stage for event in events} == {"perception"}
    assert len(events) == 4  # two views, found and cut out


def test_views_beyond_the_limit_stay_undetected(
    test_data: Path, models_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the setting, and by what the detector has time for."""
    capture = make_capture(_table_views(test_data, ["018", "020", "024"]))
    for limit, looked_at in ((1, (0,)), (0, (0, 2))):
        settings = _SETTINGS.model_copy(update={"max_views": limit, "closer_look": False})
        monkeypatch.setattr(CaptureDetector, "limited", lambda _, looked_at=looked_at: list(looked_at))
        labelling = label_capture(capture, settings, models_dir, [], silent)
        assert labelling.looked_at == looked_at
        assert [bool(label_map.any()) for label_map in labelling.label_maps] == [i in looked_at for i in range(3)]
    monkeypatch.setattr(create_scene, "label_capture", lambda *_, **__: labelling)
    assert create_scene.label_views(capture, Settings()).tradeoffs == ("words looked for in 2 of 3 views",)


def test_masks_without_names_come_with_labels_and_change_none(test_data: Path, models_dir: Path) -> None:
    """Every region of a label is one of its view's masks, and objects without a name are among the masks as well."""
    capture = make_capture(_table_views(test_data, ["018", "024"]))
    settings = _SETTINGS.model_copy(update={"proposal_views": 1, "proposal_points": 8})
    plain = label_capture(capture, settings, models_dir, ["banana", "orange"], silent)
    labelling = label_capture(capture, settings, models_dir, ["banana", "orange"], silent, masks=True)
    assert plain.masks == () and len(labelling.masks) == 2
    assert [entry.label for entry in labelling.dictionary.entries] == [e.label for e in plain.dictionary.entries]
    (before, _), (after, second_map) = plain.label_maps, labelling.label_maps
    assert (before == after).mean() > 0.998  # edges are interpolated between other steps
    assert not second_map.any()  # the first view shows both
    view_masks, none = labelling.masks
    assert view_masks is not None and none is None and len(view_masks) > len(labelling.regions[0].votes)
    height, width = labelling.label_maps[0].shape
    masks, ids = view_masks.resized(width, height), labelling.regions[0].ids
    for number in range(1, len(labelling.regions[0].votes) + 1):
        region = ids == number
        overlaps = (masks & region).sum(axis=(1, 2)) / (masks | region).sum(axis=(1, 2))
        assert overlaps.max() > 0.9


def test_the_first_views_are_shown_before_the_others_are_looked_at(
    test_data: Path, models_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Objects and masks of those that show most; no view is looked at twice, and the result is the same as unseen."""
    names = ["018", "020", "022", "024"]
    capture = make_capture(_table_views(test_data, names))
    settings = _SETTINGS.model_copy(update={"closer_look": False, "proposal_points": 2, "proposal_views": 3})
    monkeypatch.setattr(labelling_module, "EARLY_VIEWS", 2)
    looks: list[str] = []

    def counted(what: str, model: Any, method: str) -> Any:
        real = getattr(model, method)

        def call(image: np.ndarray, *more: Any) -> Any:
            looks.append(what)
            return real(image, *more)

        monkeypatch.setattr(model, method, call)
        return model

    segmenter = counted("segmented", open_segmenter(settings, models_dir), "embed")
    detector = counted("detected", open_closed_set_detector(settings, models_dir), "detect")
    monkeypatch.setattr(labelling_module, "open_segmenter", lambda *_: segmenter)
    monkeypatch.setattr(capture_detection, "open_closed_set_detector", lambda *_: detector)
    seen: list[tuple[Labelling, Sequence[int]]] = []

    def early(labelling: Labelling, views: Sequence[int]) -> None:
        assert looks == ["detected"] * 4 + ["segmented"] * 2  # names are known of all views before any mask is
        seen.append((labelling, views))

    result = label_capture(capture, settings, models_dir, [], silent, masks=True, early=early)
    ((first, views),) = seen
    assert len(views) == 2 and [number in views for number in range(4)] == [mask is not None for mask in first.masks]
    assert {number for number in range(4) if first.label_maps[number].any()} <= set(views)
    assert "cup" in {entry.label for entry in first.dictionary.entries}
    assert looks.count("detected") == 4 and looks.count("segmented") == sum(mask is not None for mask in result.masks)
    unseen = label_capture(capture, settings, models_dir, [], silent, masks=True)
    assert unseen.dictionary == result.dictionary
    for number, (before, after) in enumerate(zip(unseen.label_maps, result.label_maps, strict=True)):
        np.testing.assert_array_equal(before, after)
        assert (unseen.masks[number] is None) == (result.masks[number] is None)
    for number in views:
        mask, final = first.masks[number], result.masks[number]
        np.testing.assert_array_equal(mask.bits, final.bits)


def test_a_class_that_no_view_with_masks_shows_is_cut_out_of_the_view_that_shows_it_best() -> None:
    def detected(*found: tuple[str, float]) -> Detections:
        boxes = np.zeros((len(found), 4), np.float32)
        return Detections(boxes, np.array([score for _, score in found], np.float32), tuple(name for name, _ in found))

    views = [
        detected(("cup", 0.9)),
        detected(("cup", 0.8), ("fork", 0.4), ("spoon", 0.9)),
        detected(),
        detected(("fork", 0.6), ("cup", 0.7)),
        detected(("spoon", 0.5)),
    ]
    assert views_to_segment(views, {0, 2}) == {0, 1, 2, 3}
    assert views_to_segment(views, {0, 3}) == {0, 1, 3}
    assert views_to_segment(views, set(range(5))) == set(range(5))


def test_nothing_found_is_an_empty_dictionary(models_dir: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((60, 80, 3), 127, np.uint8))
    labelling = label_capture(make_capture([tmp_path / "grey.png"]), _SETTINGS, models_dir, [], silent)
    assert len(labelling.dictionary) == 0
    assert not labelling.label_maps[0].any()


def test_labels_beyond_the_closed_set_are_refused_by_name(test_data: Path, models_dir: Path) -> None:
    capture = make_capture(_table_views(test_data, ["018"]))
    with pytest.raises(InvalidInputError) as caught:
        label_capture(capture, _SETTINGS, models_dir, ["banana", "headset", "can opener"], silent)
    assert "headset, can opener" in caught.value.message and "banana" not in caught.value.message
    assert "open-set" in caught.value.hint


def test_the_caller_can_stop_it(test_data: Path, models_dir: Path) -> None:
    def stop(event: ProgressEvent) -> None:
        raise CancelledError("enough")

    with pytest.raises(CancelledError):
        label_capture(make_capture(_table_views(test_data, ["018"])), _SETTINGS, models_dir, [], stop)


def test_a_missing_model_stops_it_at_once(test_data: Path, models_dir: Path, tmp_path: Path) -> None:
    shutil.copytree(models_dir / "picodet_416", tmp_path / "picodet_416")

    def unreached(event: ProgressEvent) -> None:
        raise AssertionError("nothing should have run")

    with pytest.raises(ModelUnavailableError, match="mobile_sam"):
        label_capture(make_capture(_table_views(test_data, ["018"])), _SETTINGS, tmp_path, [], unreached)


@pytest.fixture
def given_capture(tmp_path: Path) -> Any:
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), np.zeros((4, 6, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "map.png"), np.array([[0, 1, 3, 3, 3, 3]] * 4, np.uint16))
    given = GivenLabels(dictionary_of(["wall", "cup", "lamp"]), (tmp_path / "map.png", None))
    return make_capture([tmp_path / "a.png", tmp_path / "b.png"], given)


def test_given_labels_need_no_model(given_capture: Any, tmp_path: Path) -> None:
    labelling = label_capture(given_capture, _SETTINGS, tmp_path / "no models", [], silent)
    found = [(entry.label, entry.pixels, entry.views, entry.confidence) for entry in labelling.dictionary.entries]
    assert found == [("wall", 4, 1, 1.0), ("cup", 0, 0, 1.0), ("lamp", 16, 1, 1.0)] and labelling.exact
    np.testing.assert_array_equal(labelling.label_maps[0], [[0, 1, 3, 3, 3, 3]] * 4)
    assert labelling.label_maps[1].shape == (4, 6) and not labelling.label_maps[1].any()


def test_given_labels_are_seen_at_once(given_capture: Any, tmp_path: Path) -> None:
    seen: list[tuple[Labelling, Sequence[int]]] = []
    labelling = label_capture(
        given_capture, _SETTINGS, tmp_path / "no models", [], silent, early=lambda *arguments: seen.append(arguments)
    )
    assert seen == [(labelling, [0, 1])]


@pytest.mark.parametrize("fault", ["size", "id"])
def test_given_labels_that_do_not_fit_are_refused(given_capture: Any, tmp_path: Path, fault: str) -> None:
    wrong = np.full((4, 5), 1, np.uint16) if fault == "size" else np.full((4, 6), 4, np.uint16)
    cv2.imwrite(str(tmp_path / "map.png"), wrong)
    with pytest.raises(InvalidInputError, match=r"\(4, 5\)" if fault == "size" else "id 4"):
        label_capture(given_capture, _SETTINGS, tmp_path, [], silent)


def test_an_open_set_detector_asks_for_what_was_found_or_for_tags(test_data: Path, models_dir: Path) -> None:
    """Prompts: the user's words; else the operator's tags; else the list, or of a Grounding DINO what is found."""
    if not (models_dir / "yolo_world_s").is_dir():
        pytest.skip("evaluation weights are not there")
    settings = PerceptionSettings(
        open_set_detector="yolo_world:yolo_world_s",
        prompt_encoder="label_table:clip_text_vocab",
        tags=("headset", "can opener"),
        threads=2,
    )
    photo = read_rgb(test_data / "tabletop" / "images" / "018.jpg")
    grey = np.full((120, 160, 3), 127, np.uint8)

    def look(image: np.ndarray, labels: list[str], settings: PerceptionSettings) -> tuple[Any, Any, str]:
        """What is searched for, what is found, and the last line of the report."""
        lines: list[str] = []
        detector = CaptureDetector(
            lambda _: image, 1, labels, settings, models_dir, lambda done, line: lines.append(line)
        )
        (found,) = detector.detections([0])
        return detector.searched, found.labels, lines[-1]

    assert "for 1 classes" in look(photo, ["banana", "Bananas"], settings)[2]
    assert "for 2 classes" in look(grey, [], settings)[2]
    searched, labels, _ = look(photo, [], settings)
    assert searched == ("headset", "can opener")
    assert "headset" in labels and set(labels) <= set(searched)
    searched, labels, _ = look(photo, [], settings.model_copy(update={"tags": ()}))
    assert "banana" in labels and "headset" not in labels and 100 < len(searched) < len(TAGS)  # the table lacks some
    few = PerceptionSettings(open_set_detector="grounding_dino:few", threads=2)
    prompts = _prompts(lambda _: photo, 1, few, models_dir, lambda *_: None)
    assert is_prompted_by_classes(few) and "banana" in prompts and len(prompts) < 20
    assert _prompts(lambda _: grey, 1, few, models_dir, lambda *_: None) == list(TAGS)
