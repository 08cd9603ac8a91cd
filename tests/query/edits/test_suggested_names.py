"""Suggested names can be asked for, say who suggests them, and are borne by nothing until a person gives them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.objects.names.merged_suggestions import merged_suggestions, source_trust
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Object, Objects
from fastsplat.service.scene.artefact.suggestions import MOST_SUGGESTED, Suggestion, ranked_suggestions
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat_contract.errors import FastSplatError
from fastsplat_contract.jobs.name_suggestions import SuggestedName
from fastsplat_contract.messages.scenes import Edit
from tests.query.conftest import DrawnEncoder
from tests.scenes import labelled_scene

_COUNT = 60
_TRUTH = {obj: f"kind {obj}x" for obj in range(1, _COUNT + 1)}
_SHARES = st.floats(0.0, 1.0)


def _objects(count: int = _COUNT, *first: Object) -> Objects:
    table = (*first, *(Object(number) for number in range(1 + len(first), count + 1)))
    rows = np.arange(count)
    return Objects(table, evidence_of(rows, rows + 1, np.full(count, 16 * UNIT), count))


@pytest.fixture
def opened() -> Callable[[Objects], SceneIndex]:
    """A scene of one Gaussian an object, ready to be asked."""

    def of(objects: Objects) -> SceneIndex:
        count = len(objects.table)
        means = np.stack([np.arange(count), np.zeros(count), np.zeros(count)], axis=1)
        scene = labelled_scene(means, np.zeros(count, int), dictionary_of([]), objects=objects)
        return SceneIndex(scene, DrawnEncoder(), QuerySettings(backend="reference"))

    return of


def _answers(source: str, seed: int) -> tuple[SuggestedName, ...]:
    """What a stand-in for an assistant says of every object: the truth, but for one in ten."""
    wrong = set(np.random.default_rng(seed).choice(_COUNT, _COUNT // 10, replace=False) + 1)
    return tuple(
        SuggestedName(obj, f"not {name}" if obj in wrong else name, 0.8, source, "stand-in")
        for obj, name in _TRUTH.items()
    )


def test_what_assistants_say_reaches_suggestions_and_nothing_is_named_without_a_person(
    opened: Callable[[Objects], SceneIndex],
) -> None:
    index = opened(_objects())
    for source, seed in (("one", 1), ("other", 2)):
        index = index.after(apply_edit(index, Edit("suggest", suggestions=_answers(source, seed))))
    suggestions = {obj.id: obj.suggestions for obj in index.objects.listed}
    reached = [_TRUTH[obj] in [suggestion.name for suggestion in names] for obj, names in suggestions.items()]
    assert np.mean(reached) >= 0.95
    assert not any(obj.name for obj in index.objects.table.everything) and not len(index.scene.dictionary)
    both = [names[0] for names in suggestions.values() if len(names[0].said_by) == 2]
    assert both and all(suggestion.probability > 0.8 for suggestion in both)
    (answer,) = index.ask([both[0].name])
    assert answer.outcome == "probably_here" and answer.probability == pytest.approx(both[0].probability)
    assert answer.sentence.endswith(f'may be "{both[0].name}", say "one" and "other".')
    # A person confirms what both say: it is named then, and what was confirmed tells how far each can be trusted.
    sure = {obj: names[0].name for obj, names in suggestions.items() if names[0].probability >= 0.9}
    before = index.ranked.names.trust
    for obj, name in sure.items():
        index = index.after(apply_edit(index, Edit("name", object_ids=(obj,), name=name)))
    assert {obj.id for obj in index.objects.table.everything if obj.source == "person"} == set(sure)
    assert not before and all(trust > 1 for trust in index.ranked.names.trust.values())
    assert index.ask([next(iter(sure.values()))])[0].outcome == "here"


def test_a_source_replaces_its_own_word_alone(opened: Callable[[Objects], SceneIndex]) -> None:
    detected = Object(1, suggestions=(Suggestion("cup", 0.42),))
    named = Object(2, "bowl", "person", 1.0)
    index = opened(_objects(3, detected, named))

    def suggestions(*suggested: SuggestedName) -> SceneIndex:
        return index.after(apply_edit(index, Edit("suggest", suggestions=suggested)))

    index = suggestions(SuggestedName(1, "mug", 0.5, "eyes"), SuggestedName(2, "dish", 0.9, "eyes"))
    index = suggestions(
        SuggestedName(1, "espresso cup", 0.6, "eyes", "v2", ("demitasse",)), SuggestedName(1, "cup", 0.5, "ears")
    )
    first, second, third = index.objects.listed
    assert [(suggestion.name, [voice.source for voice in suggestion.said_by]) for suggestion in first.suggestions] == [
        ("cup", ["ears", "detector"]),
        ("espresso cup", ["eyes"]),
    ]
    assert first.suggestions[0].probability == pytest.approx(1 - 0.58 * 0.5)
    assert second.name == "bowl" and not second.suggestions and not third.suggestions
    by_alias, of_named = index.ask(["demitasse", "dish"])
    assert by_alias.outcome == "probably_here" and by_alias.object_ids == (1,)
    trust = 4 / (0.9 + 4)  # "dish" was claimed of what a person calls a bowl
    assert by_alias.probability == pytest.approx(0.6 * trust)
    assert not of_named.object_ids  # a person has settled what it is


@pytest.mark.parametrize(
    ("changed", "field"),
    [
        ({"object_id": 99}, "suggestions[0]"),
        ({"name": " "}, "suggestions[0].name"),
        ({"aliases": ("?",)}, "suggestions[0].aliases[0]"),
        ({"source": ""}, "suggestions[0].source"),
        ({"source": "detector"}, "suggestions[0].source"),
        ({"source": "x" * 61}, "suggestions[0].source"),
        ({"probability": 1.5}, "suggestions[0].probability"),
    ],
)
def test_a_suggestion_that_is_none_is_refused(
    opened: Callable[[Objects], SceneIndex], changed: dict[str, Any], field: str
) -> None:
    index = opened(_objects(2))
    bad = replace(SuggestedName(1, "cup", 0.5, "eyes"), **changed)
    with pytest.raises(FastSplatError) as refused:
        apply_edit(index, Edit("suggest", suggestions=(bad,)))
    assert refused.value.field == field
    with pytest.raises(FastSplatError):
        apply_edit(index, Edit("suggest"))


def test_no_source_crowds_out_another(opened: Callable[[Objects], SceneIndex]) -> None:
    index = opened(_objects(1))
    many = tuple(SuggestedName(1, f"kind {n}x", 0.5, "eyes") for n in range(MOST_SUGGESTED + 1))
    with pytest.raises(FastSplatError) as refused:
        apply_edit(index, Edit("suggest", suggestions=many))
    assert refused.value.field == f"suggestions[{MOST_SUGGESTED}]"
    ranked = ranked_suggestions([*(Suggestion(f"kind {n}x", 0.9, "eyes") for n in range(9)), Suggestion("cup", 0.1)])
    assert [suggestion.source for suggestion in ranked] == ["eyes"] * MOST_SUGGESTED + [""]


@given(first=_SHARES, second=_SHARES)
def test_sources_that_agree_count_more_and_never_make_sure(first: float, second: float) -> None:
    obj = Object(1, suggestions=(Suggestion("Cups", first, "eyes"), Suggestion("cup", second, "ears")))
    (merged,) = merged_suggestions(obj, {})
    assert min(max(first, second), 0.99) - 1e-12 <= merged.probability <= 0.99
    assert len(merged.suggestions) == 2


@given(st.lists(st.tuples(st.booleans(), st.floats(0.05, 1.0)), min_size=1, max_size=20))
def test_trust_falls_with_every_name_that_a_person_gave_otherwise(confirmed: list[tuple[bool, float]]) -> None:
    def trust(rows: list[tuple[bool, float]]) -> float:
        objects = [
            Object(n, "cup" if right else "bowl", "person", 1.0, suggestions=(Suggestion("cup", p, "eyes"),))
            for n, (right, p) in enumerate(rows, start=1)
        ]
        return source_trust([said for obj in objects for said in obj.said])["eyes"]

    assert trust([*confirmed, (False, 0.5)]) < trust(confirmed) <= trust([*confirmed, (True, 1e-9)])
    cup = Object(1, "cup", "person", 1.0, suggestions=(Suggestion("bowl", 0.9),))
    assert not cup.said  # the scene's own models are measured elsewhere
