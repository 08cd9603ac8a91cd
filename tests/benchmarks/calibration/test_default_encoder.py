"""The committed calibration of the default encoder is what its script measures, and holds on scenes it never saw."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks.calibration.calibrate import acceptable, ask_scenes, measure, nonconformities
from benchmarks.calibration.separation import auroc
from benchmarks.evaluation.negative_nouns import negative_nouns
from benchmarks.evaluation.predictions import ask_all
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.query.language.meaning.calibration import calibration_for
from fastsplat.service.query.language.meaning.embeddings import TextCache
from fastsplat.service.query.language.meaning.probability import label_set
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from tests.query.conftest import make_scene
from tests.query.language.test_minilm import TABLETOP


@pytest.mark.parametrize(
    ("labels", "synonyms"),
    [
        (
            TABLETOP,
            ["headphones", "drink can", "coffee cup", "skillet", "loaf", "tin opener", "magnifier", "cornflakes"],
        ),
        (("skull",), ["cranium", "skeleton head"]),
    ],
    ids=["tabletop", "skull"],
)
def test_what_is_there_stands_out_from_a_hundred_nouns_that_are_not(
    minilm: TextEncoder, labels: Sequence[str], synonyms: list[str]
) -> None:
    index = SceneIndex(make_scene(labels, code=2), minilm, QuerySettings())
    absent = negative_nouns(labels)
    assert len(absent) >= 100
    for present in (list(labels), synonyms):
        there, missing = ask_all(index, present), ask_all(index, absent)
        high, low = (np.array([answer.matches[0].similarity for answer in side]) for side in (there, missing))
        assert auroc(high, low) >= 0.95
        assert np.mean([answer.is_absent for answer in missing]) > 0.8
        assert not any(answer.is_absent for answer in there)


def test_the_committed_calibration_is_what_its_script_measures(minilm: TextEncoder) -> None:
    settings = QuerySettings()
    for score, (measured, figures) in measure(minilm, settings.templates, settings.negatives).items():
        committed = calibration_for(minilm.name, minilm.sha256, score, settings.templates, settings.negatives)
        # int8 kernels of other processors round otherwise.
        assert committed.related == pytest.approx(measured.related, abs=0.02)
        assert committed.exact == pytest.approx(measured.exact, abs=0.02)
        assert figures["auroc_related_against_absent"] > 0.97
        for kind, error in (("entry", 0.02), ("leading_entry", 0.1), ("present", 0.08)):
            assert figures[f"{kind}_ece"] < error
            assert figures[f"{kind}_brier"] < 0.4 * figures[f"{kind}_brier_of_base_rate"]
        # The rule for what is spoken of loses no answer, and says half as much beside the point.
        before, after = figures["listed_by_threshold"], figures["listed"]
        for figure in ("found", "named_rightly", "rightly_absent"):
            assert before[figure] == after[figure]
        assert 1 - after["precision"] < 0.6 * (1 - before["precision"]) and after["recall"] > before["recall"] - 0.1


@pytest.mark.parametrize("score", ["similarity", "relevancy"])
def test_label_sets_cover_what_they_say_on_scenes_they_never_saw(minilm: TextEncoder, score: Any) -> None:
    settings = QuerySettings()
    cache = TextCache(minilm, settings.templates, 10_000)
    found = calibration_for(minilm.name, minilm.sha256, score, settings.templates, settings.negatives)
    cases = [question for question in ask_scenes(score, cache, cache.embed(settings.negatives)) if not question.named]
    judges = [question for question in cases if question.part == 3]
    assert len(judges) >= 100
    sizes = []
    for coverage in (0.5, 0.8, 0.9, 0.95):
        bounds = found.scenes.bounds(coverage)
        sets = [label_set(nonconformities(question, found), bounds) for question in judges]
        for present in (True, False):
            hits = [
                bool(acceptable(question) & set(members))
                for question, members in zip(judges, sets, strict=True)
                if bool(question.first) == present
            ]
            assert sum(hits) >= binom.ppf(0.001, len(hits), coverage)
        sizes.append(sum(map(len, sets)))
    assert sizes == sorted(sizes) and sizes[0] < sizes[-1]
