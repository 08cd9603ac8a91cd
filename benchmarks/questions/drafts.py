"""Ask the questions of `questions.txt` of every draft of a scene while it is trained, and again in the end.

    python -m benchmarks.questions.drafts --photos FOLDER --scene NAME --out FOLDER [--preset PRESET]

Prints, as JSON: seconds from posting to the first camera, to each draft and to the end; and of each draft

  agree: the share of `questions` whose outcome is that of the finished scene;
  ece: the expected calibration error (ten bins) of how probable the draft says it is that what is asked for is here,
    against how probable the finished scene says it is: who knows less says, on average, what will be said in the end.
    `Answer.probability` is that of what is shown, and of `not_here` that nothing is; so it is turned around there. It
    is not the probability that the outcome stays, nor of the final verdict: a finished scene in which things have no
    name says "not here" at 0.6, and its verdict foretells nothing better than that. Against its own verdicts the
    finished sample has an error of 0.29. Only the `judged` questions count, to which both say how probable it is.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.questions.trained_questions import read_scenes
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.library.local_scene import folder_settings
from fastsplat.service.library.training_run import train
from fastsplat_contract.operations import Operation
from fastsplat_contract.queries import Answer, QueryRequest

_BINS = 10
_SHOWN = ("here", "probably_here")


class _Watch:
    """Notes when what came, by the operation's changes."""

    def __init__(self) -> None:
        self._started = time.monotonic()
        self.seconds: dict[str, float] = {}
        self.drafts: list[str] = []

    def __call__(self, operation: Operation) -> None:
        now = round(time.monotonic() - self._started, 1)
        if operation.placed is not None:
            self.seconds.setdefault("first_camera", now)
            if operation.placed.complete:
                self.seconds.setdefault("poses", now)
        draft = operation.draft
        if draft is not None and draft.version not in self.drafts:
            self.drafts.append(draft.version)
            self.seconds[f"{draft.number} {draft.stage} {draft.fraction:.2f}"] = now
        if operation.done:
            self.seconds["done"] = now


def _asked(service: SceneService, scene_id: str, texts: Sequence[str], version: str) -> list[Answer]:
    answers: list[Answer] = []
    for begin in range(0, len(texts), 50):
        request = QueryRequest(scene_id, tuple(texts[begin : begin + 50]), version=version)
        answers += service.answers.query(request).answers
    return answers


def here_probability(answer: Answer) -> float | None:
    """0..1: how probable an answer says it is that what was asked for is here; None where it decides nothing."""
    if answer.probability is None or answer.outcome not in (*_SHOWN, "not_here"):
        return None
    return 1.0 - answer.probability if answer.outcome == "not_here" else answer.probability


def agreement(drafted: Sequence[Answer], final: Sequence[Answer]) -> dict[str, float]:
    """How well answers of a draft foretell the final ones, text by text; see the module."""
    same = [before.outcome == after.outcome for before, after in zip(drafted, final, strict=True)]
    pairs = [(here_probability(before), here_probability(after)) for before, after in zip(drafted, final, strict=True)]
    judged = [pair for pair in pairs if None not in pair]
    said, true = np.array(judged, dtype=np.float64).reshape(-1, 2).T
    bins = np.minimum((said * _BINS).astype(int), _BINS - 1)
    gaps = np.abs(np.bincount(bins, said - true, minlength=_BINS))
    return {
        "agree": float(np.mean(same)),
        "ece": float(gaps.sum()) / max(len(judged), 1),
        "questions": len(same),
        "judged": len(judged),
    }


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--photos", type=Path, required=True)
    parser.add_argument("--scene", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--preset", default=None)
    arguments = parser.parse_args()
    texts = [question.text for scene in read_scenes() if scene.name == arguments.scene for question in scene.questions]
    watch, answers = _Watch(), dict[str, list[Answer]]()
    beside: SceneService | None = None

    def follow(operation: Operation) -> None:
        nonlocal beside
        watch(operation)
        beside = beside or open_service(folder_settings(arguments.out))
        for version in watch.drafts:
            if version not in answers and not operation.done:
                begun = time.monotonic()
                answers[version] = _asked(beside, operation.scene_id, texts, version)
                watch.seconds[f"asking {len(answers)}"] = round(time.monotonic() - begun, 1)

    with train(arguments.photos, arguments.out, preset=arguments.preset, progress=follow) as scene:
        told: dict[str, Any] = {"seconds": watch.seconds, "quality": dict(scene.info.quality)}
    assert beside is not None
    final = _asked(beside, scene.id, texts, "")
    told["drafts"] = [agreement(drafted, final) for drafted in answers.values()]
    print(json.dumps(told, indent=1, default=float))


if __name__ == "__main__":
    main()
