"""What is decided of questions, before it is put into words."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from fastsplat.service.query.language.words.judgement import Ranked
from fastsplat.service.query.language.words.query_text import check_query
from fastsplat.service.query.ranked_scene import RankedQuery
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.messages.queries import Answer

TEMPLATES = (
    *("Where is the {}?", "Could you please show me my {}?", "do you know where the {} is"),
    *("I'm looking for a nice {}.", "Hi, is there any {} around here?"),
)
WANTS = (
    *("mug", "teddy bear", "stuffed animal", "red apple", "lamp", "table", "book", "bottle", "whiteboard"),
    *("black bear", "grand piano", "flurbo"),
)


def alike(ask: Callable[[Sequence[str]], Sequence[Answer]]) -> Iterator[tuple[Answer, Answer]]:
    """The answer to each phrasing of each want, and that to the bare noun with the same text."""
    for want in WANTS:
        bare, *answers = ask([want, *(template.format(want) for template in TEMPLATES)])
        yield from ((answer, replace(bare, text=answer.text)) for answer in answers)


def decided(index: SceneIndex, *texts: str, **choices: Any) -> Sequence[Ranked]:
    """What comes before the answers of `index.ask`."""
    return RankedQuery(index.ranked, check_query(texts, index.settings, **choices)).decided(lambda: index.objects)
