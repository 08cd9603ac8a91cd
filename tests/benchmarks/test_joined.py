"""Photos that join, as the benchmark chooses and measures them: those nearest join, the others show nothing that is to
be hidden, and the thing that is what was hidden is told with its name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.things.cropped import cropped, hidden_labels
from benchmarks.things.joined import _best, _nearest
from fastsplat.service.capture.types import Capture, CaptureReport, GivenLabels, View
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.evaluation.datasets.types import TrueView
from fastsplat.service.scene.label_evidence import UNIT, evidence_of
from fastsplat.service.scene.types import Thing, Things
from fastsplat.service.splatting.blending import thing_map
from fastsplat_contract.camera import Camera, PosedCamera
from tests.scenes import labelled_scene

_CAMERA = Camera(60, 40, 40.0, 40.0, 30.0, 20.0)
_BALL, _BLOCK = np.array([-0.5, 0.0, 2.0]), np.array([0.5, 0.0, 2.0])


def _posed(x: float, name: str) -> PosedCamera:
    pose = np.eye(4)
    pose[0, 3] = x
    return PosedCamera(_CAMERA, pose, name)


def _capture(folder: Path) -> Capture:
    """Four cameras in a row that look ahead, at a ball on their left and a block on their right."""
    views, maps = [], []
    for x in (-0.3, -0.1, 0.1, 0.3):
        name = f"{x}.png"
        drawn = np.zeros((40, 60), np.uint8)
        for label, place in enumerate((_BALL, _BLOCK), start=1):
            column = round(40 * (place[0] - x) / place[2] + 30)
            drawn[14:26, max(0, column - 4) : column + 4] = label
        for kind in ("images", "maps"):
            (folder / kind).mkdir(exist_ok=True)
            Image.fromarray(drawn).save(folder / kind / name)
        views.append(View(_posed(x, name), folder / "images" / name))
        maps.append(folder / "maps" / name)
    places = np.repeat(np.stack([_BALL, _BLOCK]), 50, axis=0)
    points = (places + np.random.default_rng(0).uniform(-0.2, 0.2, places.shape)).astype(np.float32)
    given = GivenLabels(dictionary_of(["ball", "block"]), tuple(maps))
    report = CaptureReport("images", len(views))
    return Capture(tuple(views), points, np.zeros_like(points, np.uint8), "ARBITRARY", report, given_labels=given)


def test_the_nearest_photos_join_and_no_other_shows_what_is_to_be_hidden(tmp_path: Path) -> None:
    capture = _capture(tmp_path)
    measured = TrueView("measured", _posed(0.35, "measured"))
    new = _nearest(capture, measured, 2)
    assert new == {"0.1.png", "0.3.png"}
    assert hidden_labels(capture, new) == []
    (tmp_path / "crops").mkdir()
    cut = cropped(capture, new, 0.5, tmp_path / "crops")
    assert hidden_labels(cut, new) == [2]
    for before, after in zip(capture.views, cut.views, strict=True):
        if before.posed.name in new:
            assert after == before
            continue
        with Image.open(after.image_path) as image:
            shown = np.asarray(image)
        camera = after.posed.camera
        assert shown.shape == (camera.height, camera.width) and (shown == 1).any() and not (shown == 2).any()
        left, top = round(_CAMERA.cx - camera.cx), round(_CAMERA.cy - camera.cy)
        with Image.open(before.image_path) as image:
            whole = np.asarray(image)
        assert np.array_equal(shown, whole[top : top + camera.height, left : left + camera.width])


def test_the_thing_that_is_what_was_hidden_is_told_with_its_name() -> None:
    means = np.concatenate([place + 0.02 * np.mgrid[-3:4, -3:4, 0:1].reshape(3, -1).T for place in (_BALL, _BLOCK)])
    count, owner = len(means), np.repeat([1, 2], len(means) // 2)
    table = (Thing(1, "ball", "detected", 0.9), Thing(2, "block", "detected", 0.9))
    things = Things(table, evidence_of(np.arange(count), owner, np.full(count, UNIT), count))
    scene = replace(labelled_scene(means, owner, ("ball", "block")), things=things)
    posed = _posed(0.0, "measured")
    view = TrueView("measured", posed, labels=thing_map(scene, posed).astype(np.int32))
    assert 2 in np.unique(thing_map(scene, posed))
    assert _best(scene, [view], 2) == ("block", 1.0)
    assert _best(scene, [view], 3) == ("", 0.0)
