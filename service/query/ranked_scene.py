"""What is answered of a scene without its Gaussians: all but pictures, masks and what must be measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.language.english import is_foreign, names_nothing
from fastsplat.service.query.language.query_text import TextQuery
from fastsplat.service.query.language.ranking import Ranked, Ranker
from fastsplat.service.query.phrases.phrase_grammar import parsed_questions
from fastsplat.service.query.things.thing_names import ThingNames
from fastsplat.service.scene.types import Gaussians, Scene
from fastsplat_contract.queries import Answer

if TYPE_CHECKING:
    from fastsplat.service.query.things.thing_index import SceneThings

_PER_THING = 1_024
"""Bytes: a row of the table, its place among its label's, suggestions."""


class RankedScene:
    """The labels and the names of things of one scene, ready to be asked. Threads may share it.

    Args:
        scene: only its sizes are kept.
        ranker: of its labels.
        things: those that the scene stores, or None.

    Attributes:
        blank: as many Gaussians as the scene has, with as many harmonics, all zero; they take no memory.
    """

    def __init__(self, scene: Scene, ranker: Ranker, things: ThingNames | None) -> None:
        self.ranker = ranker
        self._things = things
        self._unit = "m" if scene.scale == "METRIC" else "unit"
        shapes = {name: array.shape for name, array in vars(scene.gaussians).items()}
        self.blank = Gaussians(**{name: np.broadcast_to(np.float32(0), shape) for name, shape in shapes.items()})

    @property
    def nbytes(self) -> int:
        """What it weighs in memory, estimated; it does not depend on the number of Gaussians."""
        things = 0 if self._things is None else len(self._things.present) + len(self._things.parts)
        return self.ranker.nbytes + _PER_THING * things

    def answer(
        self, query: TextQuery, things: Callable[[], SceneThings], asker: NDArray[np.float64] | None = None
    ) -> tuple[Answer, ...]:
        """One answer per text of a checked question, see `SceneIndex.answer`.

        Args:
            query: the question.
            things: all things of the scene; called only where a phrase needs measures of them, or where the scene
                stores none.
            asker: float64 [4, 4], world from who asks.
        """
        answers = self.ranker.rank(query)
        if self._things is not None:
            names = self._things
            answers = tuple(
                replace(answer, things=names.of_labels(answer.relevant_ids) or answer.things) for answer in answers
            )
        parsed = parsed_questions(query.texts, self.ranker.names, self.ranker.is_name)
        surfaces = [] if self._things is None else [thing for thing in self._things.present if thing.surface]
        if not any(parsed) and not surfaces:
            return answers
        from fastsplat.service.query.phrases.phrase_answers import AskedScene, answer_phrase, answer_surface

        def rank(texts: Sequence[str]) -> tuple[Ranked, ...]:
            return self.ranker.rank_meant(replace(query, texts=tuple(texts)))

        named = things().names if self._things is None else self._things
        scene = AskedScene(named, self.ranker.names, rank, lambda: things().measures, self._unit)
        return tuple(
            (answer_surface(plain, scene) if phrase is None else answer_phrase(phrase, plain, scene, asker))
            if not is_foreign(plain.text) and not names_nothing(plain.text)
            else plain
            for plain, phrase in zip(answers, parsed, strict=True)
        )
