"""The benchmark of reading: rooms whose printed lines are where they are said to be, and figures of what is read."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.reads.__main__ import figures, judged
from benchmarks.reads.drawing import FlatStudio
from benchmarks.reads.labels import Line, labelled_room
from benchmarks.rooms.drawing import camera_of
from fastsplat.service.scene.artefact.scene import Object, Objects
from fastsplat.service.scene.objects.label_evidence import evidence_of
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.messages.object_reads import ObjectRead


def test_ink_is_where_lines_are_and_covered_lines_have_no_height() -> None:
    room, lines = labelled_room(3)
    studio, camera = FlatStudio(room, 800), camera_of(640)
    seen = 0
    for pose in room.poses[::6]:
        drawing = studio.draw(PosedCamera(camera, pose, "view"))
        for line in lines:
            height = line.height_in(drawing)
            if height >= 8:
                seen += 1
                corners = (line.corners - pose[:3, 3]) @ pose[:3, :3]
                pixels = corners[:, :2] / corners[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy) - 0.5
                inside = np.zeros((camera.height, camera.width), np.uint8)
                cv2.fillConvexPoly(inside, np.round(pixels).astype(np.int32), 1)
                light = drawing.light.mean(axis=2)[inside > 0]
                assert set(drawing.objects[inside > 0]) == {line.object_id}
                assert np.percentile(light, 95) > 1.5 * np.percentile(light, 5)  # ink on its ground
                assert line.height_in(studio.draw(PosedCamera(camera, pose @ np.diag([-1, 1, -1, 1]), "back"))) == 0
    assert seen > 10


def test_figures_count_lines_of_the_right_object_letter_for_letter() -> None:
    corners = np.zeros((4, 3))
    lines = [Line(1, "Oat Milk", corners), Line(2, "Rice", corners), Line(2, "tiny", corners)]
    reads = {
        1: (ObjectRead("text", "OATMILK", 0.9, 3), ObjectRead("text", "Rice", 0.8, 2)),
        2: (ObjectRead("text", "tiny", 0.7, 2),),
    }
    objects = Objects(
        tuple(Object(number, reads=reads[number]) for number in (1, 2)), evidence_of(*(np.zeros(0, np.int64),) * 3, 0)
    )
    said, found = judged(objects, lines, (True, True, False))
    assert sorted(said) == [(0.7, True), (0.8, False), (0.9, True)] and found == [0.9, 0.0]
    measured = figures(said, found)
    assert measured["precision"] == pytest.approx(2 / 3, abs=1e-4) and measured["recall"] == 0.5
    assert (measured["recall_at_95"], measured["threshold"]) == (0.5, 0.9)
