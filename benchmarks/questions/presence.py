"""Ask scenes, as the product trains them, single words of which photos show the object or do not (`presence.txt`).

    python -m benchmarks.questions.presence --scenes FOLDER [--half test] [--misses] [--row NAME]

FOLDER is as for `benchmarks.questions`. A hash of scene and word puts half of the words aside: rules were chosen on the
half "validation"; "test" is asked once, after all changes. Writes a row of benchmarks/results/presence.json, counts of
what was asked:
  there: words of what is there: `found` shows the right object first, `other` another object, `denied` says "not here"
      or
    "not seen"; `offered` cannot be said, with the right object among those that it may be, `evaded` without it;
  gone: words of the detector's kinds that are absent, and other: further absent words, by outcome;
  evasions: what is evaded of what is there, and what cannot be said of the detector's kinds that are absent.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from benchmarks.provenance import RESULTS, begin, parser_of, provenance, write_json
from benchmarks.questions.__main__ import truth_in
from benchmarks.questions.judging import Truth
from benchmarks.questions.trained_questions import Photographed, object_of, read_scenes
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.library.local_scene import open_scene
from fastsplat_contract.messages.queries import Answer

FILE = Path(__file__).with_name("presence.txt")


def read_words(path: Path = FILE) -> Iterator[tuple[str, str, str]]:
    """Scene, list and word or, in the list "object", the line of what `questions.txt` gives no place of."""
    scene = ""
    for line in filter(None, path.read_text().splitlines()):
        if line.startswith("["):
            scene = line.strip("[]")
        elif line.startswith("object "):
            yield scene, "object", line.removeprefix("object ")
        elif not line.startswith("#"):
            kind, words = line.split(": ")
            yield from ((scene, kind, word) for word in words.split(", "))


def half_of(scene: str, word: str) -> str:
    """The half that a word belongs to."""
    return "test" if hashlib.sha256(f"{scene}: {word}".encode()).digest()[0] & 1 else "validation"


def outcome_of(word: str, kind: str, answer: Answer, truth: Truth) -> str:
    """What an answer counts as, see the module."""
    if kind != "there":
        return answer.outcome
    names = {key: set(map(label_key, right_names)) for key, right_names in truth.right_names.items()}
    right = {truth.ids[key] for key in truth.ids if label_key(word) in names[key]}
    if answer.is_absent:
        return "denied"
    if answer.outcome == "cannot_say":
        return "offered" if right & set(answer.object_ids) else "evaded"
    return "found" if right & set(answer.object_ids[:1]) else "other"


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--scenes", type=Path, required=True, help="a folder with a data folder for each scene")
    parser.add_argument("--half", choices=("validation", "test"), default="validation")
    parser.add_argument("--misses", action="store_true", help="print the answers")
    parser.add_argument("--row", help="of the result file, which it replaces; by default the half")
    options = parser.parse_args()
    start, words = begin(), list(read_words())
    counts: dict[str, Counter[str]] = {"there": Counter(), "gone": Counter(), "other": Counter()}
    for photographed in read_scenes():
        name, folder = photographed.name, options.scenes / photographed.name
        extra_objects = tuple(object_of(line) for scene, kind, line in words if (scene, kind) == (name, "object"))
        scene_words = [(kind, word) for scene, kind, word in words if scene == name and kind in counts]
        if folder.is_dir():
            with open_scene(folder) as scene:
                truth = truth_in(scene, Photographed(name, (*photographed.objects, *extra_objects), ()))
                for kind, word in scene_words:
                    if half_of(name, word) == options.half:
                        answer = scene.ask(word)
                        said = outcome_of(word, kind, answer, truth)
                        counts[kind][said] += 1
                        if options.misses:
                            print(f"{name} {kind} {said} {word!r} {list(answer.object_ids)[:8]}: {answer.sentence}")
    evasions = [
        counts["there"]["evaded"] + counts["gone"]["cannot_say"],
        counts["there"].total() + counts["gone"].total(),
    ]
    row = {**{kind: dict(counter) for kind, counter in counts.items()}, "evasions": evasions}
    print(json.dumps(row, indent=1))
    file, about = RESULTS / "presence.json", provenance(start, settings=options, chosen_on="the half validation")
    rows = json.loads(file.read_text())["rows"] if file.is_file() else {}
    write_json(file, {"rows": {**rows, options.row or options.half: {**row, **about}}})


if __name__ == "__main__":
    _main()
