"""Score answers to drawn questions about places, sizes, colors, orders and numbers on rooms whose layout is known.

    python -m benchmarks.relations [--questions N] [--seed N] [--misses]

Rooms are drawn until there are N questions that the placing decides, and all those that it does not decide come along.
Writes benchmarks/results/relations.json:
  right: share of the decided questions whose objects (or number) are those of the placing, by kind;
  rightly_refused: share of the undecided ones that are refused with a reason, by what makes them undecided;
  wrongly_refused, wrong: of the decided ones; guessed: of the undecided ones, answered without a refusal.
Intervals are 95 % (Wilson). The truth comes from how objects were placed (`questions.py`). Bounds were set on the rooms
of seeds 1000 and 2000, and left as they were for seed 0.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.provenance import begin, parser_of, write_results
from benchmarks.relations.questions import ROOMS, Case
from fastsplat.service.query.language.words.query_text import check_query
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.ranked_scene import RankedQuery
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.messages.queries import Answer
from tests.query.box_scenes import rigid
from tests.query.placed_rooms import scene_of


class HashEncoder:
    """A direction drawn from the hash of each text: only names count."""

    name = "drawn"
    sha256 = "0" * 64

    def encode(self, texts: Sequence[str]) -> np.ndarray:
        """float32 [N, 16], unit length."""
        seeds = [int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") for text in texts]
        vectors = np.stack([np.random.default_rng(seed).standard_normal(16) for seed in seeds])
        return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), np.float32)


_CHOSEN_ON = "bounds of relations, sizes and colors: on the rooms of seeds 1000 and 2000"


@dataclass(frozen=True)
class Answered:
    """A case and what the product said.

    Attributes:
        case: the question.
        seed: of its room.
        objects: ids that were answered; None for a refusal.
        count: that was answered.
        reason: of a refusal, "" without.
        explanation: the sentence.
    """

    case: Case
    seed: int
    objects: frozenset[int] | None
    count: int | None
    reason: str
    explanation: str

    @property
    def right(self) -> bool:
        """Whether it is the truth, or a refusal where there is none."""
        if self.case.truth is None:
            return self.objects is None
        return self.objects == self.case.truth and self.count == self.case.count


def answer_drawn(decided: int, seed: int = 0) -> list[Answered]:
    """Answers to at least so many questions that are decided, and to those undecided ones that come with them."""
    answered: list[Answered] = []
    room_seed = seed
    while sum(reply.case.truth is not None for reply in answered) < decided:
        rng = np.random.default_rng([seed, room_seed])
        drawn = ROOMS[room_seed % len(ROOMS)](rng)
        world = rigid(rng)
        settings = QuerySettings()
        indices = {
            vertical: SceneIndex(scene_of(drawn.room, room_seed, world, vertical), HashEncoder(), settings)
            for vertical in {case.vertical for case in drawn.cases}
        }
        for case in drawn.cases:
            asker = None if case.asker is None else world @ case.asker
            index = indices[case.vertical]
            query = check_query((case.text,), settings)
            (answer,) = RankedQuery(index.ranked, query).answer(partial(getattr, index, "objects"), asker)
            answered.append(_judged(case, room_seed, answer))
        room_seed += 1
    return answered


def figures(answered: Sequence[Answered]) -> dict[str, Any]:
    """The figures of the module's description."""
    decided = [reply for reply in answered if reply.case.truth is not None]
    undecided = [reply for reply in answered if reply.case.truth is None]
    refused = sum(reply.objects is None for reply in decided)
    return {
        "decided": share_right([reply.right for reply in decided]),
        "wrongly_refused": refused,
        "wrong": sum(not reply.right for reply in decided) - refused,
        "decided_by_kind": _by_kind(decided),
        "rightly_refused": share_right([reply.right for reply in undecided]),
        "guessed": sum(not reply.right for reply in undecided),
        "refused_by_kind": _by_kind(undecided),
    }


def _judged(case: Case, seed: int, answer: Answer) -> Answered:
    phrase = answer.phrase
    if phrase is None:  # a name, of which all objects are meant
        return Answered(case, seed, frozenset(answer.object_ids), None, "", answer.sentence)
    objects = None if phrase.refusal is not None else frozenset(phrase.object_ids)
    reason = "" if phrase.refusal is None else phrase.refusal.reason
    return Answered(case, seed, objects, phrase.count, reason, answer.sentence)


def _by_kind(answered: Sequence[Answered]) -> dict[str, Any]:
    kinds: defaultdict[str, list[bool]] = defaultdict(list)
    for reply in answered:
        kinds[reply.case.kind].append(reply.right)
    return {kind: share_right(kinds[kind]) for kind in sorted(kinds)}


def share_right(right: Sequence[bool]) -> dict[str, Any]:
    """How many are right, with the 95 % interval of their share (Wilson 1927)."""
    count, share, z = len(right), float(np.mean(right)), 1.96
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * float(np.sqrt(share * (1 - share) / count + z * z / (4 * count * count)))
    return {
        "questions": count,
        "right": round(share, 4),
        "interval": [round(middle - half, 4), round(middle + half, 4)],
    }


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--questions", type=int, default=300, help="decided questions, at least")
    parser.add_argument("--seed", type=int, default=0, help="of the first room")
    parser.add_argument("--misses", action="store_true", help="print what was answered otherwise")
    options = parser.parse_args()
    start = begin()
    answered = answer_drawn(options.questions, options.seed)
    for reply in answered if options.misses else ():
        if not reply.right:
            truth = reply.case.truth if reply.case.count is None else reply.case.count
            said = reply.reason or (reply.objects if reply.case.count is None else reply.count)
            print(f"room {reply.seed}, {reply.case.kind}: {reply.case.text!r}: {truth} but {said}: {reply.explanation}")
    document = {"seed": options.seed, **figures(answered)}
    for name in ("decided", "rightly_refused"):
        print(name, document[name])
    for name in ("decided_by_kind", "refused_by_kind"):
        for kind, share in document[name].items():
            print(f"  {kind}: {share['right']} of {share['questions']}")
    write_results("relations", start, options, _CHOSEN_ON, document)


if __name__ == "__main__":
    _main()
