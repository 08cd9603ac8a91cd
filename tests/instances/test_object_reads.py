"""What is written on objects: read in drawn photos of two boards, and voted on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageDraw, ImageFont

from fastsplat.service.capture.captures import View
from fastsplat.service.common.edit_distance import text_difference
from fastsplat.service.instances.naming.object_reads import voted_reads, with_reads
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.readers.ppocr import open_reader
from fastsplat.service.perception.results import LineReader, Writing
from fastsplat.service.scene.artefact.scene import Gaussians, Object, Objects
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.messages.object_reads import ObjectRead
from tests.instances.known_objects import gaussians_at, grid

_CAMERA = Camera(640, 480, 500.0, 500.0, 320.0, 240.0)
_BOARDS = (3, 7)
_CORNERS = np.zeros((4, 2), np.float32)


def _world() -> tuple[Gaussians, Objects]:
    """Two boards of 0.8 by 1 m, one meter away, left and right of the middle."""
    boards = [grid(0.5, 0.8, 0.02, 1.0, (side * 0.3, 0.0)) for side in (-1, 1)]
    owner = np.repeat(_BOARDS, [len(board) for board in boards])
    full = np.full(len(owner), 16 * UNIT, np.int64)
    membership = evidence_of(np.arange(len(owner)), owner, full, len(owner))
    return gaussians_at(np.concatenate(boards)), Objects(tuple(Object(board) for board in _BOARDS), membership)


def _view(folder: Path, number: int, words: Sequence[tuple[tuple[int, int], str]], code: str = "") -> View:
    """A photo of 640 by 480: words at pixels, and a QR code on the right board."""
    page = Image.new("RGB", (640, 480), (200, 196, 188))
    for place, text in words:
        ImageDraw.Draw(page).text(place, text, font=ImageFont.load_default(28), fill=(30, 30, 60))
    if code:
        coded = np.pad(cv2.QRCodeEncoder.create().encode(code), 4, constant_values=255)
        page.paste(Image.fromarray(cv2.resize(coded, None, fx=5, fy=5, interpolation=cv2.INTER_NEAREST)), (390, 250))
    path = folder / f"{number}.png"
    page.save(path)
    return View(PosedCamera(_CAMERA, np.eye(4), path.name), path)


def _reads(objects: Objects) -> dict[int, set[tuple[str, str]]]:
    return {obj.id: {(read.kind, read.text) for read in obj.reads} for obj in objects.table}


@pytest.fixture(scope="module")
def reader(reader_models_dir: Path) -> LineReader:
    return open_reader(PerceptionSettings(threads=2), reader_models_dir)


def test_each_object_has_what_is_written_on_it_and_nobody_what_is_between_them(
    reader: LineReader, tmp_path: Path
) -> None:
    gaussians, objects = _world()
    words = [[((84 + x, 150), "oat milk"), ((410 + x, 150), "Woolf"), ((270, 20), "between")] for x in (0, 5, 10)]
    views = [_view(tmp_path, number, lines, "https://example.org/a") for number, lines in enumerate(words)]
    heard: list[tuple[int, int]] = []
    read = with_reads(objects, gaussians, views, reader, 160, lambda *step: heard.append(step))
    assert _reads(read) == {3: {("text", "oat milk")}, 7: {("text", "Woolf"), ("qr", "https://example.org/a")}}
    assert all(reading.views >= 2 and reading.probability > 0.6 for obj in read.table for reading in obj.reads)
    assert heard == [(1, 3), (2, 3), (3, 3)]
    assert replace(read, table=objects.table) == objects  # nothing else is touched


def test_what_a_photo_withholds_says_nothing(reader: LineReader, tmp_path: Path) -> None:
    gaussians, objects = _world()
    view = _view(tmp_path, 0, [((80, 150), "oat milk"), ((410, 150), "Woolf")])
    usable = np.full((480, 640), 255, np.uint8)
    usable[150:200, 60:250] = 0
    cv2.imwrite(str(tmp_path / "usable.png"), usable)
    view = replace(view, valid_path=tmp_path / "usable.png")
    assert _reads(with_reads(objects, gaussians, [view], reader, 160)) == {3: set(), 7: {("text", "Woolf")}}


def test_codes_are_read_without_a_reader_of_words(tmp_path: Path) -> None:
    gaussians, objects = _world()
    views = [_view(tmp_path, 0, [((80, 150), "oat milk")], "https://example.org/a")]
    assert _reads(with_reads(objects, gaussians, views, None, 160)) == {3: set(), 7: {("qr", "https://example.org/a")}}


def _text(text: str, probability: float = 0.9) -> Writing:
    return Writing("text", text, probability, _CORNERS)


def test_views_outvote_one_that_misreads_and_a_part_of_a_line_is_none() -> None:
    said = ["To the Lighthouse", "To the Lighthouse", "To the Lighthause", "Lighthouse"]
    (read,) = voted_reads([(view, _text(text)) for view, text in enumerate(said)])
    assert (read.kind, read.text, read.views) == ("text", "To the Lighthouse", 2)
    (alone,) = voted_reads([(0, _text("To the Lighthouse"))])
    assert alone.probability < 0.9  # one view is less sure than its reader says


def test_one_view_alone_is_not_believed_where_many_read_something_else() -> None:
    rivals = [(view, _text("oat milk")) for view in range(1, 3)]
    assert len(voted_reads([(0, _text("Woolf")), *rivals])) == 2
    assert len(voted_reads([(0, _text("Woolf")), *rivals, (3, _text("oat milk"))])) == 1


@given(st.integers(1, 12), st.floats(0.65, 1.0))
def test_more_views_make_it_surer_and_contradiction_less_sure(views: int, sure: float) -> None:
    agreeing = [(view, _text("oat milk", sure)) for view in range(views)]
    (read,), (more,) = voted_reads(agreeing), voted_reads([*agreeing, (views, _text("oat milk", sure))])
    assert read.probability <= more.probability <= 1 and more.views == read.views + 1
    for contradicted in voted_reads([*agreeing, (views, _text("oat mulk", sure))]):
        assert contradicted.probability < read.probability


def test_what_is_hardly_seen_is_not_kept_and_codes_are_never_mixed() -> None:
    assert voted_reads([(0, _text("oat milk", 0.4)), (1, _text("Q", 1.0)), (2, _text("- .", 1.0))]) == ()
    codes = [Writing("barcode", digits, 1.0, _CORNERS) for digits in ("4006381333931", "4006381333932")]
    read = voted_reads([(0, codes[0]), (1, codes[0]), (1, codes[1])])
    assert [(reading.text, reading.views) for reading in read] == [("4006381333931", 2), ("4006381333932", 1)]
    assert all(isinstance(reading, ObjectRead) for reading in read)


_WORD: st.SearchStrategy[str] = st.text("abcd", max_size=8)


@given(_WORD, _WORD, _WORD)
def test_the_difference_of_texts_is_a_distance(left: str, right: str, third: str) -> None:
    def steps(first: str, second: str) -> float:
        return text_difference(first, second) * max(len(first), len(second))

    assert (text_difference(left, right) == 0) == (left == right)
    assert text_difference(left, right) == text_difference(right, left) <= 1
    assert steps(left, third) <= steps(left, right) + steps(right, third) + 1e-9


@given(_WORD, _WORD, st.floats(0, 1))
def test_a_bound_of_differences_changes_none_that_keeps_it(left: str, right: str, most: float) -> None:
    whole, bounded = text_difference(left, right), text_difference(left, right, most)
    assert bounded == whole if whole <= most else bounded > most
