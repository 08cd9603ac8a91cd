"""What a detector's names are worth is measured on rooms whose objects are known, and predicts rooms that are not."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count, islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.instances.naming.name_models import load_name_model, save_name_model
from fastsplat.service.jobs import detector_calibration
from fastsplat.service.jobs.detector_calibration import calibrate_detector
from fastsplat.service.jobs.looks_rooms import LabeledRoom, drawn_rooms
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling, Regions
from fastsplat_contract.errors import ModelUnavailableError

_SETTINGS = PerceptionSettings(open_set_detector="owlv2:mine")


@pytest.fixture(scope="module")
def rooms() -> Sequence[LabeledRoom]:
    return tuple(drawn_rooms())


@pytest.fixture
def models(tmp_path: Path) -> Path:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "network.onnx").write_bytes(b"network")
    return tmp_path


def _labelled(monkeypatch: pytest.MonkeyPatch, rooms: Sequence[LabeledRoom], knows: float, step_s: int = 0) -> None:
    """Objects are segmented as they are, and called by their names in this share, else by any; clocks step."""
    random, left, clock = np.random.default_rng(3), iter(rooms), count(0, step_s)

    def label(capture: Capture, settings: PerceptionSettings, *rest: Any) -> Labelling:
        room, names = next(left), settings.tags
        rest[-1](ProgressEvent("perception", 0.5, "looking"))
        called = {}
        for number, word in room.labels.items():
            right = random.random() < knows
            row = names.index(word) if right else int(random.integers(len(names)))
            called[number] = (row + 1, random.beta(6, 3) if right else random.beta(3, 6))
        regions = []
        for _, ids in room.views:
            present = np.unique(ids[ids > 0])
            votes = tuple((called[number],) for number in present.tolist())
            regions.append(Regions(np.searchsorted(present, ids, "right").astype(np.uint16) * (ids > 0), votes))
        return Labelling(dictionary_of(names), tuple(region.ids for region in regions), regions=tuple(regions))

    monkeypatch.setattr(detector_calibration, "label_capture", label)
    monkeypatch.setattr(detector_calibration, "time", SimpleNamespace(monotonic=lambda: next(clock)))


def test_what_a_detector_is_worth_is_predicted_for_rooms_that_set_nothing(
    monkeypatch: pytest.MonkeyPatch, rooms: Sequence[LabeledRoom], models: Path
) -> None:
    _labelled(monkeypatch, rooms, 0.6)
    events: list[ProgressEvent] = []
    found = calibrate_detector(_SETTINGS, models, events.append, rooms)
    counts = found.held_out
    assert counts is not None and found.measured and found.factor > 0
    assert counts.called == counts.objects and 0.5 < counts.right / counts.called < 0.75
    error = 3 * np.sqrt(counts.expected * (1 - counts.expected / counts.given)) + 0.05 * counts.given
    assert counts.given > 100 and abs(counts.given_right - counts.expected) < error
    assert [event.fraction for event in events] == sorted(event.fraction for event in events)
    save_name_model(found, models)
    stored = load_name_model("owlv2:mine", models)
    assert stored is not None and stored.model_copy(update={"sha256": {}}) == found


def test_a_detector_that_knows_nothing_is_refused(
    monkeypatch: pytest.MonkeyPatch, rooms: Sequence[LabeledRoom], models: Path
) -> None:
    _labelled(monkeypatch, rooms, 0.0)
    found = calibrate_detector(_SETTINGS, models, rooms=rooms)
    assert not found.measured and "not calibrated" in found.summary


def test_a_slow_detector_looks_at_fewer_rooms_or_is_refused_at_once(
    monkeypatch: pytest.MonkeyPatch, rooms: Sequence[LabeledRoom], models: Path
) -> None:
    _labelled(monkeypatch, rooms, 0.6, 50)
    assert len(calibrate_detector(_SETTINGS, models, rooms=rooms).sets) == 12
    _labelled(monkeypatch, rooms, 0.6, 150)
    with pytest.raises(ModelUnavailableError, match="300 s in drawn room 1") as caught:
        calibrate_detector(_SETTINGS, models, rooms=rooms)
    assert "1200 s" in caught.value.limit


def test_a_real_detector_is_measured_through_segmenter_and_votes(models_dir: Path) -> None:
    """Evaluation weights, which name half of two drawn rooms at best."""
    if not (models_dir / "yolo_world_s").is_dir():
        pytest.skip("evaluation weights are not there")
    prompts = {"prompt_encoder": "label_table:clip_text_vocab"}
    settings = PerceptionSettings(open_set_detector="yolo_world:yolo_world_s", **prompts)
    found = calibrate_detector(settings, models_dir, rooms=islice(drawn_rooms(), 2))
    assert found.held_out is not None and found.held_out.right > 3 + found.held_out.chance
