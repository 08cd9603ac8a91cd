"""Ask scenes, as the product trains them, questions whose truth their photos show.

    python -m benchmarks.questions --scenes FOLDER [--half first|second|both] [--misses]

FOLDER holds a data folder for each scene of `questions.txt`, under its name: what `fastsplat train PHOTOS` made of the
photos; "sample" is the one that the package brings where it has none. Questions are halved by hash: what is mended is
looked for in the first half, and `--misses` prints that half alone. Writes benchmarks/results/questions.json:
  right: share of the answers that `judging.py` calls right, over all, by scene, by kind, by half;
  not_here_but_named: answers "not here" of what is there and bears a right name;
  contradictions: answers that contradict themselves;
  undecided: share of the answers that say nothing can be said;
  named: how many of the objects that the questions speak of are things with a right name, by scene.
"""

from __future__ import annotations

import io
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.provenance import NOT_CHOSEN, begin, parser_of, write_results
from benchmarks.questions.judging import Truth, contradictions, is_right, truth_of
from benchmarks.questions.trained_questions import Photographed, Question, read_scenes, things_of, views_by_photo
from benchmarks.relations.__main__ import share_right
from fastsplat.service.library.local_scene import LocalScene, open_scene
from fastsplat.service.library.sample import open_sample
from fastsplat_contract.queries import Answer, PictureRequest


@dataclass(frozen=True)
class Judged:
    """One question, its answer and what is to be said of that."""

    question: Question
    answer: Answer
    right: bool
    named: bool
    contradictions: tuple[str, ...]

    @property
    def denied(self) -> bool:
        """Whether it is "not here" of something that is there and named."""
        return self.named and self.answer.verdict == "absent"


def truth_in(scene: LocalScene, photographed: Photographed) -> Truth:
    """Which things of a scene are what its photos show."""

    @cache
    def thing_map(view: str) -> NDArray[np.uint16]:
        content = scene._service.answers.picture(
            PictureRequest(kind="thing_map", view=view, format="npy", scene_id=scene.id)
        )
        return np.asarray(np.load(io.BytesIO(content)))

    ids = things_of(photographed.objects, views_by_photo(scene.views), thing_map)
    return truth_of(photographed.objects, ids, {thing.id: thing.name for thing in scene.things()})


def ask_all(scene: LocalScene, photographed: Photographed, truth: Truth) -> list[Judged]:
    """The answers to all questions of one scene."""
    names = {name for name in truth.names.values() if name}
    names |= {each.name for thing in scene.things() if not thing.name for each in thing.suggestions}
    judged = []
    views = views_by_photo(scene.views)
    for question in photographed.questions:
        answer = scene.ask(question.text, asker_view=views.get(question.view))
        named = any(truth.named(key) for key in question.keys)
        right = is_right(question, answer, truth)
        judged.append(Judged(question, answer, right, named, tuple(contradictions(answer, names))))
    return judged


def figures(judged: Sequence[Judged]) -> dict[str, Any]:
    """The figures of the module's description, without `named`."""
    return {
        "right": share_right([each.right for each in judged]),
        "by_half": _grouped(judged, lambda each: "second" if each.question.scored_once else "first"),
        "by_scene": _grouped(judged, lambda each: each.question.scene),
        "by_kind": _grouped(judged, lambda each: each.question.kind),
        "not_here_but_named": sum(each.denied for each in judged),
        "contradictions": sum(bool(each.contradictions) for each in judged),
        "undecided": share_right([each.answer.verdict == "undecided" for each in judged]),
    }


def _grouped(judged: Sequence[Judged], key: Callable[[Judged], str]) -> dict[str, dict[str, Any]]:
    groups: defaultdict[str, list[bool]] = defaultdict(list)
    for each in judged:
        groups[key(each)].append(each.right)
    return {name: share_right(groups[name]) for name in sorted(groups)}


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--scenes", type=Path, required=True, help="a folder with a data folder for each scene")
    parser.add_argument("--half", choices=("first", "second", "both"), default="both")
    parser.add_argument("--misses", action="store_true", help="print what is not right in the first half")
    options = parser.parse_args()
    start = begin()
    judged: list[Judged] = []
    objects = {}
    with ExitStack() as stack:
        for photographed in read_scenes():
            folder = options.scenes / photographed.name
            of_package = photographed.name == "sample" and not folder.is_dir()
            scene = stack.enter_context(open_sample() if of_package else open_scene(folder))
            truth = truth_in(scene, photographed)
            judged += ask_all(scene, photographed, truth)
            named = [each.key for each in photographed.objects if truth.named(each.key)]
            objects[photographed.name] = {"objects": len(photographed.objects), "named": named}
    halves = {"first": (False,), "second": (True,), "both": (False, True)}[options.half]
    judged = [each for each in judged if each.question.scored_once in halves]
    for each in judged if options.misses else ():
        if not each.question.scored_once and (not each.right or each.denied or each.contradictions):
            question, answer = each.question, each.answer
            print(f"{question.scene}, {question.kind}: {question.text!r} -> {question.keys} {question.count or ''}")
            print(
                f"  {answer.verdict} {answer.probability} {answer.things}: {answer.explanation} {each.contradictions}"
            )
    document = {
        **figures(judged),
        "named": objects,
    }
    for name in ("right", "by_half", "by_scene", "by_kind", "not_here_but_named", "contradictions", "undecided"):
        print(name, document[name])
    write_results("questions", start, options, NOT_CHOSEN, document)


if __name__ == "__main__":
    _main()
