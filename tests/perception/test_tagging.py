"""Taggers: the contract, tags pooled over views, and what an open-set detector is then asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.perception.label_maps.capture_detection import CaptureDetector
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.tagging import open_tagger, pool_tags
from fastsplat_contract.errors import ModelUnavailableError
from tests.networks import write_network

_RED, _GREEN, _BLUE = ((np.eye(3, dtype=np.uint8) * 255)[axis] for axis in range(3))
_SETTINGS = PerceptionSettings(tagger="ram:colors")


def _picture(*colors: np.ndarray) -> np.ndarray:
    """uint8 [60, 80, 3] of vertical bands."""
    columns = np.repeat(np.stack(colors), -(-80 // len(colors)), axis=0)[:80]
    return np.broadcast_to(columns, (60, 80, 3)).copy()


@pytest.fixture
def tagger_folder(tmp_path: Path) -> Path:
    """A model directory with a tagger: each channel's mean, after the normalization of ImageNet, through a sigmoid."""
    write_network(
        tmp_path / "colors" / "model.onnx",
        """
        colors (float[1,3,32,32] image) => (float[1,3] probabilities)
        <float four = {4.0}, float middle = {0.3}>
        {
          mean = ReduceMean<axes = [2, 3], keepdims = 0>(image)
          above = Sub(mean, middle)
          sharp = Mul(above, four)
          probabilities = Sigmoid(sharp)
        }
        """,
    )
    (tmp_path / "colors" / "tags.txt").write_text("red wall\ngreen wall\nblue wall\n")
    return tmp_path


def test_a_tagger_says_what_a_picture_shows(tagger_folder: Path) -> None:
    tagger = open_tagger(_SETTINGS, tagger_folder)
    assert tagger.tags == ("red wall", "green wall", "blue wall")
    probabilities = tagger.tag(_picture(_GREEN))
    assert probabilities.argmax() == 1 and probabilities[1] > 0.9 and probabilities[[0, 2]].max() < 0.1


def test_tags_may_have_thresholds_and_the_names_that_their_authors_gave(tagger_folder: Path) -> None:
    folder = tagger_folder / "colors"
    assert open_tagger(_SETTINGS, tagger_folder).thresholds == pytest.approx([0.68] * 3)
    (folder / "tags.txt").rename(folder / "ram_tag_list.txt")
    for name, thresholds in (("ram_tag_list_threshold.txt", [0.2, 0.3, 0.4]), ("thresholds.txt", [0.5, 0.6, 0.7])):
        (folder / name).write_text("\n".join(map(str, thresholds)))
        assert open_tagger(_SETTINGS, tagger_folder).thresholds == pytest.approx(thresholds)


@pytest.mark.parametrize(
    ("file", "content", "complaint"),
    [
        ("tags.txt", "red wall\ngreen wall\n", "does not keep its contract at probabilities"),
        ("tags.txt", "", "is empty"),
        ("tags.txt", None, "cannot be read"),
        ("thresholds.txt", "0.5\n0.6\n", "does not hold 3 numbers"),
        ("thresholds.txt", "0.5\n0.6\n7\n", "does not hold 3 numbers"),
        ("thresholds.txt", "0.5\n0.6\nhigh\n", "something else than numbers"),
        ("model.onnx", "no network", "damaged or not an ONNX model"),
        ("model.onnx", None, "should hold one network"),
    ],
)
def test_a_broken_contract_is_said(tagger_folder: Path, file: str, content: str | None, complaint: str) -> None:
    path = tagger_folder / "colors" / file
    path.unlink() if content is None else path.write_text(content)
    with pytest.raises(ModelUnavailableError, match=complaint) as caught:
        open_tagger(_SETTINGS, tagger_folder)
    assert caught.value.field == "ram:colors" and caught.value.hint


def test_logits_are_known_by_name_or_by_values(tmp_path: Path) -> None:
    mean = (np.array([1, 0, 0]) - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]  # ImageNet's
    for output, shift, expected in (("logits", 2.5, mean + 2.5), ("other", 0.0, mean), ("other", 2.5, None)):
        network = f"colors (float[1,3,H,W] image) => (float[1,3] {output}) <float shift = {{{shift}}}>"
        network += f"{{ mean = ReduceMean<axes = [2, 3], keepdims = 0>(image) {output} = Add(mean, shift) }}"
        write_network(tmp_path / "colors" / "model.onnx", network)
        (tmp_path / "colors" / "tags.txt").write_text("a\nb\nc\n")
        tagger = open_tagger(_SETTINGS, tmp_path)
        if expected is not None:
            assert tagger.tag(_picture(_RED)) == pytest.approx(1 / (1 + np.exp(-expected)), abs=1e-4)
    with pytest.raises(ModelUnavailableError, match="no probability") as caught:  # black is within 0..1, red is not
        tagger.tag(_picture(_RED))
    assert "sigmoid" in caught.value.hint and "logits" in caught.value.hint


@given(
    hnp.arrays(np.float32, st.tuples(st.integers(0, 6), st.just(5)), elements=st.floats(0, 1, width=32)),
    st.floats(0, 1),
    st.integers(1, 6),
    st.integers(1, 5),
)
def test_pooled_tags_are_those_that_enough_views_show(
    probabilities: np.ndarray, min_share: float, min_views: int, limit: int
) -> None:
    tags, thresholds = ["cup", "Cups", "lamp", "red chair", "sofa"], np.array([0.5, 0.6, 0.7, 0.8, 0.0], np.float32)
    pooled = pool_tags(tags, probabilities, thresholds, min_share=min_share, min_views=min_views, limit=limit)
    views = len(probabilities)
    keys = [label_key(tag.tag) for tag in pooled]
    assert len(keys) == len(set(keys)) <= limit
    assert [tag.share for tag in pooled] == sorted((tag.share for tag in pooled), reverse=True)
    for tag in pooled:
        column = probabilities[:, tags.index(tag.tag)]
        matches = column[column >= thresholds[tags.index(tag.tag)]]
        assert len(matches) == pytest.approx(tag.share * views) and len(matches) >= min(min_views, views)
        assert tag.share >= min_share - 1e-6 and tag.probability == pytest.approx(matches.mean(), abs=1e-5)
    if limit == 5:
        matches = {
            label_key(tag)
            for tag, column, threshold in zip(tags, probabilities.T, thresholds, strict=True)
            if (column >= threshold).sum() >= max(min(min_views, views), min_share * views, 1)
        }
        assert set(keys) == matches


def test_the_tags_of_all_views_become_the_texts(tagger_folder: Path, models_dir: Path) -> None:
    """Two of three views are red, one is red and blue: red is asked for first, and only what enough views show."""
    for name in ("mobile_sam", "yolo_world_s", "clip_text_vocab", "picodet_416"):
        if not (models_dir / name).is_dir():
            pytest.skip("evaluation weights are not there")
        (tagger_folder / name).symlink_to(models_dir / name)
    (tagger_folder / "colors" / "tags.txt").write_text("stop sign\nbanana\ncup\n")  # the table's words are few
    settings = _SETTINGS.model_copy(
        update={
            "open_set_detector": "yolo_world:yolo_world_s",
            "prompt_encoder": "label_table:clip_text_vocab",
            "tagger_threshold": 0.5,
            "min_views": 1,
            "min_view_share": 0.5,
        }
    )
    pictures = [_picture(_RED), _picture(_RED), _picture(_RED, _BLUE)]
    lines: list[str] = []

    def searched(settings: PerceptionSettings, labels: list[str]) -> tuple[str, ...]:
        return CaptureDetector(
            lambda view: pictures[view], 3, labels, settings, tagger_folder, lambda done, line: lines.append(line)
        ).searched

    assert searched(settings, []) == ("stop sign",)
    assert lines[:3] == [f"tagging, view {number}/3" for number in (1, 2, 3)]
    every = settings.model_copy(update={"min_view_share": 0.3})
    assert searched(every, []) == ("stop sign", "cup")
    assert searched(every.model_copy(update={"tagger_texts": 1}), []) == ("stop sign",)
    assert searched(settings, ["banana"]) == ("banana",)  # a user's words go before
    nothing = settings.model_copy(update={"tagger_threshold": 1.0, "tags": ("banana",)})
    assert searched(nothing, []) == ("banana",)  # as without a tagger
