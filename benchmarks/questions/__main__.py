"""Ask scenes, as the product trains them, questions whose truth their photos show.

    python -m benchmarks.questions --scenes FOLDER [--only NAME,NAME] [--misses] [--row NAME]

FOLDER holds a data folder for each scene of `questions.txt`, under its name: what `fastsplat train PHOTOS` made of the
photos; "sample" is the one that the package brings where it has none. The questions have three parts:
  mending: half of sample, tabletop and kitchen, by hash. The rules of answers and of `judging.py` were changed after a
    look at its misses, which `--misses` prints: it validates, and tests nothing;
  scored: their other half. Nobody looked at its misses, but it was scored before, with 114 of 129 right, and what was
    changed since then is scored again;
  doll: all questions to plush. Their misses are read, and they validate like "mending".
Writes a row of benchmarks/results/questions.json, and leaves its other rows as they are:
  right: how many of the questions have answers that `judging.py` calls right, over all, by part, scene and kind, with
    the 95 % interval of their share (Wilson);
  not_here_but_named: answers "not here" of what is there and bears a right name;
  contradictions: answers that contradict themselves;
  undecided: answers that say nothing can be said;
  named: how many of the objects that the questions speak of are objects with a right name, by scene.
"""

from __future__ import annotations

import io
import json
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.provenance import RESULTS, begin, parser_of, provenance, write_json
from benchmarks.questions.judging import Truth, contradictions, is_right, truth_of
from benchmarks.questions.trained_questions import Photographed, Question, objects_of, read_scenes, views_by_photo
from benchmarks.relations.__main__ import share_right
from fastsplat.service.library.local_scene import LocalScene, open_scene
from fastsplat.service.library.sample import open_sample
from fastsplat_contract.messages.queries import Answer
from fastsplat_contract.photos.pictures import PictureRequest

_CHOSEN_ON = "rules of answers and of judging: on the parts mending and doll"


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
        return self.named and self.answer.outcome == "not_here"


def truth_in(scene: LocalScene, photographed: Photographed) -> Truth:
    """Which objects of a scene are what its photos show."""

    @cache
    def object_map(view: str) -> NDArray[np.uint16]:
        content = scene._service.answers.picture(
            PictureRequest(kind="object_map", view=view, format="npy", scene_id=scene.id)
        )
        return np.asarray(np.load(io.BytesIO(content)))

    ids = objects_of(photographed.objects, views_by_photo(scene.views), object_map)
    return truth_of(photographed.objects, ids, {obj.id: obj.name for obj in scene.objects()})


def ask_all(scene: LocalScene, photographed: Photographed, truth: Truth) -> list[Judged]:
    """The answers to all questions of one scene."""
    names = {name for name in truth.names.values() if name}
    names |= {suggestion.name for obj in scene.objects() if not obj.name for suggestion in obj.suggestions}
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
        **_counted([verdict.right for verdict in judged]),
        "by_part": _grouped(judged, lambda verdict: verdict.question.part),
        "by_scene": _grouped(judged, lambda verdict: verdict.question.scene),
        "by_kind": _grouped(judged, lambda verdict: verdict.question.kind),
        "not_here_but_named": sum(verdict.denied for verdict in judged),
        "contradictions": sum(bool(verdict.contradictions) for verdict in judged),
        "undecided": sum(verdict.answer.outcome == "cannot_say" for verdict in judged),
    }


def _grouped(judged: Sequence[Judged], key: Callable[[Judged], str]) -> dict[str, dict[str, Any]]:
    groups: defaultdict[str, list[bool]] = defaultdict(list)
    for verdict in judged:
        groups[key(verdict)].append(verdict.right)
    return {name: _counted(groups[name]) for name in sorted(groups)}


def _counted(right: Sequence[bool]) -> dict[str, Any]:
    """How many are right of how many, with the 95 % interval of their share."""
    return {"right": sum(right), "questions": len(right), "interval": share_right(right)["interval"]}


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--scenes", type=Path, required=True, help="a folder with a data folder for each scene")
    parser.add_argument("--only", default="", help="scenes, by their names with commas between; by default all")
    parser.add_argument("--row", default="validation", help="of the result file, which it replaces")
    parser.add_argument(
        "--misses", action="store_true", help="print what is not right, but for the part that is scored"
    )
    options = parser.parse_args()
    start = begin()
    judged: list[Judged] = []
    objects = {}
    known = read_scenes()
    wanted = options.only.split(",") if options.only else [scene.name for scene in known]
    with ExitStack() as stack:
        for photographed in known:
            if photographed.name not in wanted:
                continue
            folder = options.scenes / photographed.name
            of_package = photographed.name == "sample" and not folder.is_dir()
            scene = stack.enter_context(open_sample() if of_package else open_scene(folder))
            truth = truth_in(scene, photographed)
            judged += ask_all(scene, photographed, truth)
            named = [obj.key for obj in photographed.objects if truth.named(obj.key)]
            objects[photographed.name] = {"objects": len(photographed.objects), "named": named}
    for verdict in judged if options.misses else ():
        if verdict.question.part != "scored" and (not verdict.right or verdict.denied or verdict.contradictions):
            question, answer = verdict.question, verdict.answer
            print(f"{question.scene}, {question.kind}: {question.text!r} -> {question.keys} {question.count or ''}")
            print(f"  {answer.object_ids}: {answer.sentence} {verdict.contradictions}")
    row = {**figures(judged), "named": objects, **provenance(start, settings=options, chosen_on=_CHOSEN_ON)}
    for name in (
        "right",
        "questions",
        "by_part",
        "by_scene",
        "by_kind",
        "not_here_but_named",
        "contradictions",
        "undecided",
    ):
        print(name, row[name])
    file = RESULTS / "questions.json"
    rows = json.loads(file.read_text())["rows"] if file.is_file() else {}
    write_json(file, {"rows": {**rows, options.row: row}})


if __name__ == "__main__":
    _main()
