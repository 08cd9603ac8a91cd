"""What the paper's kitchen answers (FAST-Splat, section 5), by the default encoder with the lexicon beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from fastsplat.service.perception.lexicon.open_lexicon import open_lexicon
from fastsplat.service.perception.lexicon.wordnet import Lexicon
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.perception.types import TextEncoder
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.settings import QuerySettings
from fastsplat_contract.queries import Answer
from tests.query.conftest import make_scene

_KITCHEN = ("kettle", "coffee machine", "sink", "cabinet", "countertop", "wall", "bottle", "knife", "spoon")
_NO_KETTLE = _KITCHEN[1:]
_WORKSHOP = ("hammer", "saw", "vise", "workbench")

Ask = Callable[[Sequence[str], str], Answer]


@pytest.fixture(scope="module")
def encoder(lexicon_models_dir: Path) -> TextEncoder:
    return open_text_encoder("minilm_l6_int8", lexicon_models_dir, threads=1)


@pytest.fixture(scope="module")
def lexicon(lexicon_models_dir: Path) -> Iterator[Lexicon]:
    opened = open_lexicon("wordnet", lexicon_models_dir)
    yield opened
    opened.close()


@pytest.fixture
def ask(encoder: TextEncoder, lexicon: Lexicon) -> Ask:
    def ask(labels: Sequence[str], text: str) -> Answer:
        (answer,) = SceneIndex(make_scene(labels, code=2), encoder, QuerySettings(), lexicon=lexicon).ask([text])
        assert answer.method == "lexicon"
        return answer

    return ask


@pytest.mark.parametrize(
    ("labels", "text", "found"),
    [
        (_KITCHEN, "tea", ["kettle", "coffee machine"]),
        (_NO_KETTLE, "tea", ["coffee machine"]),
        (_KITCHEN, "fork", ["spoon", "knife"]),
        (_KITCHEN, "coffee", ["coffee machine"]),
        (_KITCHEN, "cooking pot", ["kettle"]),
        (_KITCHEN, "water", ["sink", "bottle"]),
        (_WORKSHOP, "mallet", ["hammer"]),
    ],
)
def test_an_ambiguous_question_is_answered_with_the_precise_label(
    ask: Ask, labels: Sequence[str], text: str, found: Sequence[str]
) -> None:
    answer = ask(labels, text)
    assert not answer.is_absent
    relevant = [match.label for match in answer.matches if match.relevant]
    assert relevant[: len(found)] == found
    assert f'"{found[0]}"' in answer.sentence
    assert answer.probability == answer.matches[0].probability


@pytest.mark.parametrize("text", ["piano", "toilet", "submarine", "axe"])
def test_what_is_not_there_is_said_to_be_absent(ask: Ask, text: str) -> None:
    for labels in (_KITCHEN, _WORKSHOP):
        answer = ask(labels, text)
        assert answer.is_absent and not any(match.relevant for match in answer.matches)


def test_an_everyday_kind_is_a_kind(ask: Ask) -> None:
    """WordNet has only paper for stationery; the list of common things says that a stapler is some."""
    answer = ask(("stapler", "cat", "oven"), "stationery")
    assert (answer.matches[0].label, answer.relation, answer.relation_subject) == ("stapler", "kind_of", "label")
