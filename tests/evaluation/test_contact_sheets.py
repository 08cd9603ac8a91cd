"""Sheets show every panel, and color right, wrong and missing as they say."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.evaluation.contact_sheets import label_sheet, query_sheet
from fastsplat.service.evaluation.datasets.reading import read_dataset
from fastsplat.service.evaluation.datasets.types import QueryTruth, TrueView
from fastsplat.service.evaluation.scene_evaluation import evaluate_scene
from fastsplat.service.evaluation.types import QueryPrediction, ViewPrediction
from fastsplat.service.query.drawing.pictures import label_colors
from tests.evaluation import made_data


def _sheets(folder: Path, labels: tuple[str, ...]) -> tuple[np.ndarray, TrueView]:
    dataset = read_dataset(made_data.nerfstudio(folder), CaptureSettings())
    drawn: list[np.ndarray] = []
    index = made_data.index(made_data.scene(labels))
    evaluate_scene(index, dataset, samples=0, on_view=lambda view: drawn.append(label_sheet(view)))
    assert len(drawn) == len(dataset.test)
    return drawn[0], dataset.test[0]


def _share(sheet: np.ndarray, color: tuple[int, int, int]) -> float:
    return float((sheet == color).all(axis=2).mean())


def test_a_perfect_answer_has_no_red_and_an_exchanged_one_has(tmp_path: Path) -> None:
    right, view = _sheets(tmp_path / "a", made_data.LABELS)
    wrong, _ = _sheets(tmp_path / "b", (made_data.LABELS[1], made_data.LABELS[0], made_data.LABELS[2]))
    missing, _ = _sheets(tmp_path / "c", (*made_data.LABELS[:2], "elephant"))
    assert right.dtype == np.uint8 and right.shape[1] > 5 * made_data.CAMERA.width
    assert _share(right, (230, 40, 40)) == 0 == _share(right, (250, 200, 30))
    assert _share(wrong, (230, 40, 40)) > 0.001
    assert _share(missing, (250, 200, 30)) > 0.001
    assert view.rgb is not None and any((right[y : y + 48, :64] == view.rgb).all() for y in range(right.shape[0] - 47))


def test_a_query_sheet_has_a_row_for_each_text() -> None:
    mask = np.zeros((48, 64), bool)
    mask[10:20, 10:20] = True
    one, both = query_sheet(_asked(mask, [mask])), query_sheet(_asked(mask, [mask, ~mask]))
    assert both.shape == (2 * one.shape[0], *one.shape[1:])
    assert _share(one, (60, 180, 90)) > 0 and _share(one, (230, 40, 40)) == 0
    assert _share(both[one.shape[0] :], (230, 40, 40)) > 0 < _share(both[one.shape[0] :], (250, 200, 30))


def _asked(truth: np.ndarray, answers: list[np.ndarray]) -> ViewPrediction:
    """A view in which "mug" is asked as often as there are answers."""
    view = TrueView("a.png", None, rgb=made_data.picture(1), queries=(QueryTruth("mug", truth, ()),) * len(answers))
    (answer,) = made_data.index().ask(["mug"])
    relevancy = np.zeros(truth.shape, np.float32)
    queries = tuple(
        QueryPrediction(query, 1, answer, mask, mask, relevancy, mask)
        for query, mask in zip(view.queries, answers, strict=True)
    )
    label_map = np.zeros(truth.shape, np.int32)
    return ViewPrediction(view, dictionary_of(["mug"]), label_map, queries, made_data.picture(2), None)


def test_every_label_of_a_large_dictionary_has_a_color_unlike_its_neighbours() -> None:
    colors = label_colors(len(dictionary_of([f"thing {number}" for number in range(200)]))).astype(int)
    assert colors.shape == (201, 3) and (colors[0] == 0).all()
    assert (np.abs(np.diff(colors, axis=0)).sum(axis=1) > 60).all()
    assert label_colors(0).shape == (1, 3)
