"""Score the product's answers on questions that no weight was fitted to. They have been read at every step of the work
on answers, so they validate it and test nothing any more.

    python -m benchmarks.absence --models DIR [--encoder NAME] [--lexicon NAME] [--misses]

Every question of `questions.txt` is asked of a scene that has its dictionary, through the product's own ranking. Writes
benchmarks/results/absence.json:
  found_and_named: share of the present questions that are not said to be absent and whose first answer is acceptable;
  rightly_absent: share of the absent questions that are said to be absent;
  auroc: that a present question's `presence` is above an absent one's (ties half);
  leading_ece: calibration error of the leading entry's probability, over ten bins of equal count;
  label_sets: how often the 90 % label set holds an acceptable answer where there is one, and says "nothing here" where
    there is none, and its mean size;
  undecided: share of all questions of which it is said that they cannot be answered; none of them counts as right;
  found_and_named_unlisted: found_and_named of the questions that the list of common objects does not hold word by word.
Intervals are 95 %, by 2,000 draws of whole dictionaries.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from benchmarks.absence.questions import ABSENT, PRESENT, Case, doubles, listed_keys, read_cases
from benchmarks.calibration.separation import auroc, calibration_error
from benchmarks.provenance import begin, parser_of, write_results
from fastsplat.service.common.dictionary import dictionary_of, label_key
from fastsplat.service.perception.lexicon.wordnet import Lexicon, open_lexicon
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.language.meaning.embeddings import embed_labels
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Gaussians, Scene, SemanticHead
from fastsplat_contract.messages.queries import Answer

_DRAWS = 2_000


@dataclass(frozen=True)
class _Answered:
    """A case and what the product said: `first` is the leading label, `probability` its own, 0..1."""

    case: Case
    absent: bool
    undecided: bool
    first: str
    probability: float
    presence: float
    label_set: tuple[str, ...]  # "" for "nothing here"
    method: str

    @property
    def right(self) -> bool:
        if self.undecided:
            return False
        return self.absent if not self.case.answers else not self.absent and self.first in self.case.answers

    @property
    def covered(self) -> bool:
        return bool(set(self.case.answers or ("",)) & set(self.label_set))


def answer_cases(
    cases: Sequence[Case], encoder: TextEncoder, settings: QuerySettings, lexicon: Lexicon | None = None
) -> list[_Answered]:
    """What the product says to each case, in order, with a lexicon beside the encoder or without.

    Raises:
        ValueError: the encoder is not calibrated.
    """
    answered = []
    for labels, group in groupby(cases, key=lambda case: case.labels):
        index = SceneIndex(_scene_of(labels, encoder, settings), encoder, settings, lexicon=lexicon)
        for case in group:
            (answer,) = index.ask([case.question])
            answered.append(_answered(case, answer))
    return answered


def figures(answered: Sequence[_Answered]) -> dict[str, float]:
    """The figures of the module's description over these answers."""
    present = [row for row in answered if row.case.answers]
    absent = [row for row in answered if not row.case.answers]
    right = np.array([row.first in row.case.answers for row in answered], dtype=np.float64)
    listed = listed_keys()
    unlisted = [row.right for row in present if label_key(row.case.question) not in listed]
    return {
        "found_and_named": float(np.mean([row.right for row in present])),
        "found_and_named_unlisted": float(np.mean(unlisted)) if unlisted else 0.0,
        "rightly_absent": float(np.mean([row.right for row in absent])),
        "auroc": auroc(np.array([e.presence for e in present]), np.array([e.presence for e in absent])),
        "leading_ece": calibration_error(np.array([row.probability for row in answered]), right),
        "label_sets_covered_present": float(np.mean([row.covered for row in present])),
        "label_sets_covered_absent": float(np.mean([row.covered for row in absent])),
        "undecided": float(np.mean([row.undecided for row in answered])),
        "label_sets_size": float(np.mean([len([name for name in row.label_set if name]) for row in answered])),
    } | {kind: float(np.mean([row.right for row in answered if row.case.list == kind])) for kind in PRESENT + ABSENT}


def intervals(answered: Sequence[_Answered], seed: int = 0) -> dict[str, tuple[float, float]]:
    """95 % interval of each figure, over draws of whole dictionaries: questions to one are not independent."""
    by_scene = [list(group) for _, group in groupby(answered, key=lambda row: row.case.scene)]
    rng = np.random.default_rng(seed)
    draws = [
        figures([row for place in rng.integers(len(by_scene), size=len(by_scene)) for row in by_scene[place]])
        for _ in range(_DRAWS)
    ]

    def bounds(name: str) -> tuple[float, float]:
        lower, upper = np.percentile([draw[name] for draw in draws], [2.5, 97.5])
        return float(lower), float(upper)

    return {name: bounds(name) for name in draws[0]}


def _answered(case: Case, answer: Answer) -> _Answered:
    if answer.method == "names":
        raise ValueError("this encoder is not calibrated: run benchmarks.calibration.calibrate first")
    best = answer.matches[0]
    names = tuple(case.labels[label_id - 1] if label_id else "" for label_id in answer.label_set)
    return _Answered(
        case,
        answer.is_absent,
        answer.outcome == "cannot_say",
        best.label,
        best.probability or 0.0,
        _presence(answer),
        names,
        answer.method,
    )


def _presence(answer: Answer) -> float:
    """Of an answer that leaves it open, a half."""
    return 0.5 if answer.presence is None else answer.presence


def _scene_of(labels: Sequence[str], encoder: TextEncoder, settings: QuerySettings) -> Scene:
    """A scene of one Gaussian a label: no figure here reads geometry."""
    count = len(labels)
    codes = np.eye(count + 1, dtype=np.float32)
    dictionary = dictionary_of(labels)
    return Scene(
        gaussians=Gaussians(
            means=np.zeros((count, 3), np.float32),
            quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
            log_scales=np.zeros((count, 3), np.float32),
            logit_opacities=np.zeros(count, np.float32),
            sh=np.zeros((count, 1, 3), np.float32),
            codes=codes[1:],
        ),
        head=SemanticHead(10 * codes, np.zeros(count + 1, np.float32)),
        dictionary=dictionary,
        label_embeddings=embed_labels(dictionary, encoder, settings.templates),
        label_templates=settings.templates,
        text_encoder=(encoder.name, encoder.sha256),
        cameras=(),
        scale="ARBITRARY",
    )


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__)
    parser.add_argument("--models", type=Path, required=True, help="model directory")
    parser.add_argument("--encoder", default="minilm_l6_int8", help="text encoder of the model manifest")
    parser.add_argument("--lexicon", default="wordnet", help="lexicon of the model manifest; empty: none")
    parser.add_argument(
        "--misses", action="store_true", help="print every wrong answer; whoever reads them must not fit"
    )
    arguments = parser.parse_args()
    start = begin()
    cases = read_cases()
    if wrong := list(doubles(cases)):
        raise SystemExit("\n".join(wrong))
    encoder = open_text_encoder(arguments.encoder, arguments.models)
    lexicon = open_lexicon(arguments.lexicon, arguments.models) if arguments.lexicon else None
    answered = answer_cases(cases, encoder, QuerySettings(), lexicon)
    if lexicon is not None and any(row.method != "lexicon" for row in answered):
        raise SystemExit("this encoder was not measured with this lexicon: run benchmarks.calibration.calibrate first")
    values, bounds = figures(answered), intervals(answered)
    for name, value in values.items():
        print(f"{name:20} {value:.3f}  [{bounds[name][0]:.3f}, {bounds[name][1]:.3f}]")
    if arguments.misses:
        for row in answered:
            if not row.right:
                said = "absent" if row.absent else row.first
                print(f"{row.case.scene}, {row.case.list}: {row.case.question!r} -> {said} ({row.probability:.2f})")
    chosen = "calibration: on benchmarks/calibration, which shares no question; these were read at every step"
    document = {
        "encoder": arguments.encoder,
        "lexicon": arguments.lexicon or None,
        "dictionaries": len({case.scene for case in cases}),
        "questions": {kind: sum(case.list == kind for case in cases) for kind in PRESENT + ABSENT},
        "figures": {name: {"value": round(value, 4), "interval": bounds[name]} for name, value in values.items()},
    }
    write_results("absence", start, arguments, chosen, document)


if __name__ == "__main__":
    main()
