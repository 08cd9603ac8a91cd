"""Benchmarks by which settings are chosen measure views of the training split unless `make bench` says otherwise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.calibration import calibrate
from benchmarks.calibration.folds import folds_of
from benchmarks.calibration.lists import read_scenes
from benchmarks.splits import HELD_OUT, with_split
from benchmarks.training.posed_folder import load_posed_folder
from fastsplat.service.splatting.training_views import capture_split
from tests.benchmarks.evaluation import made_data


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Twelve views, of which two are for testing; label maps by id."""
    return made_data.nerfstudio(tmp_path / "made", 12, (1, 4))


def test_test_views_are_held_out_when_they_are_measured_and_gone_when_settings_are_chosen(folder: Path) -> None:
    capture, labelling = load_posed_folder(folder)
    assert capture.test_names == ("001.png", "004.png")
    test, maps = with_split(capture, labelling, capture.test_names, "test")
    assert test.views == capture.views and maps is labelling
    assert capture_split(test, HELD_OUT)[1] == (1, 4)
    chosen, maps = with_split(capture, labelling, capture.test_names, "validation")
    names = [view.posed.name for view in chosen.views]
    assert len(names) == 10 and not set(names) & set(capture.test_names)
    assert 1 <= len(chosen.test_names) < 10 and set(chosen.test_names) < set(names)
    assert [names[row] for row in capture_split(chosen, HELD_OUT)[1]] == list(chosen.test_names)
    whole = {view.posed.name: label_map for view, label_map in zip(capture.views, labelling.label_maps, strict=True)}
    assert all((whole[name] == label_map).all() for name, label_map in zip(names, maps.label_maps, strict=True))


def test_without_a_split_of_its_own_every_fifth_view_tests(folder: Path) -> None:
    made_data.change_json(folder / "transforms.json", lambda document: document.pop("split"))
    assert load_posed_folder(folder)[0].test_names == ("002.png", "007.png")


def test_templates_are_chosen_without_the_scenes_that_judge(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other judges change what a calibration is said to be worth, and nothing of what templates are chosen by."""
    encoder, scenes = made_data.WordEncoder(), read_scenes()
    parts = folds_of([scene.labels for scene in scenes], 4)
    other_scenes = [
        replace(s, questions=s.questions[:-3]) if part == 3 else s for s, part in zip(scenes, parts, strict=True)
    ]
    chosen, judged = (calibrate.measure(encoder, ("{}",), ("object",), choosing=choosing) for choosing in (True, False))
    monkeypatch.setattr(calibrate, "read_scenes", lambda: other_scenes)
    assert calibrate.measure(encoder, ("{}",), ("object",), choosing=True) == chosen
    assert calibrate.measure(encoder, ("{}",), ("object",)) != judged
