"""What holds of an encoder with calibrated probabilities, whatever the dictionary."""

from __future__ import annotations

from typing import Any

import pytest

from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from tests.query.conftest import make_scene
from tests.query.decisions import decided


@pytest.mark.parametrize(
    ("count", "temperature"), [(0, None), (1, None), (2, None), (2, 0.0), (2, 1e6), (10_000, None)]
)
def test_calibrated_answers_of_any_dictionary_are_whole(
    calibrated_encoder: Any, count: int, temperature: float | None
) -> None:
    settings = QuerySettings(temperature=temperature)
    index = SceneIndex(make_scene([f"object {i}x" for i in range(count)], code=2), calibrated_encoder, settings)
    assert index.calibrated
    for text in ("茶壶", "🧸", "object", "object 0x", "where?"):
        ranked = [decided(index, text, coverage=coverage)[0] for coverage in (1e-9, 0.5, 0.9, 1 - 1e-9)]
        sets, verdict = [decision.answer for decision in ranked], ranked[0].verdict
        for answer in sets:
            named = count > 0 and text == "object 0x"
            assert len(answer.matches) == count and ranked[0].named == named
            assert 0 <= answer.presence <= 1
            assert (answer.probability is None) == (verdict == "undecided")
            assert answer.probability is None or 0.5 <= answer.probability <= 1 or verdict == "related"
            assert answer.presence >= max((match.probability for match in answer.matches), default=0)
            if verdict == "absent":
                assert answer.probability == pytest.approx(1 - answer.presence)
            assert answer.label_set and set(answer.label_set) <= set(range(count + 1))
            assert all(0 <= match.probability <= 1 and 0 <= match.relevancy <= 1 for match in answer.matches)
            if named:
                assert answer.label_set == (1,) and answer.probability == 1
        sizes = [len(answer.label_set) for answer in sets]
        assert sizes == sorted(sizes) and sizes[0] == 1 and (sizes[-1] == count + 1 or ranked[0].named)
        assert {(decision.verdict, decision.answer.matches) for decision in ranked} == {(verdict, sets[0].matches)}
        if not count:
            assert verdict == ("undecided" if text in ("茶壶", "🧸", "where?") else "absent")
            assert sets[0].presence == 0 and sets[-1].label_set == (0,)
