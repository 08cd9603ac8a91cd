"""A drawn room is named whole by what a stand-in for a captioner suggests, and by nobody but the person."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from benchmarks.naming.__main__ import drawn_index, named_room
from benchmarks.reads.drawing import FlatStudio
from benchmarks.reads.labels import labelled_room
from fastsplat.service.perception.text.text_encoders import open_text_encoder


def test_a_room_is_named_whole_with_one_confirmation_an_object(tmp_path: Path, models_dir: Path) -> None:
    room, _ = labelled_room(300)
    kinds = ("cup", "drum", "lamp", "kettle", "spade", "globe", "candle", "stool", "jar", "tray", "brush", "clock")
    placed = zip(room.objects[2:], kinds, strict=False)  # all different, as one name for most would be refused
    room.objects[2:] = [replace(obj, label=kind) for obj, kind in placed]
    encoder = open_text_encoder("minilm_l6_int8", models_dir)
    index = drawn_index(room, FlatStudio(room, 400).draw, 1, 4, tmp_path, encoder)
    single, two = (named_room(index, room, tmp_path, 1, count) for count in (1, 2))
    assert 8 <= single["objects"] <= 12 and single["stated"] == two["stated"] == single["refused"] == 0
    assert single["named"] == two["named"] == single["objects"] and single["obeyed"] == 0
    wrong = single["objects"] - single["first"]
    assert 1 <= wrong <= 2 and single["reached"] == single["first"] and single["wrong_at_once"] == wrong
    assert two["reached"] >= max(single["reached"], two["objects"] - 1)  # both may err about the same object
    assert single["keystrokes"] > 1 + single["objects"]  # the wrong names are typed
    assert single["seconds"] <= 90
