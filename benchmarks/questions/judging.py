"""What makes an answer right: what a user who stands before the objects would say of it.

- Something is there, and bears a right name: it has to be shown first, with at least half of what is named of the rest
  (of uses and orders one of them will do), and at least half of what is shown has to be right. "Not here" and "cannot
  say" are wrong.
- Something is there, and has no name, or a wrong one: it may be shown as well; that it cannot be said, or that nothing
  with a name is it while the answer speaks of objects without one, is no false statement, and right.
- Colors, relations and orders of what is named have to be decided; of what is not named, as above.
- A number has to be the true one; where not each of the objects is one with its name, it may be left open.
- Near to what is here, but not here: "not here", that it cannot be said, or a probability below one half. Far from
  it: "not here"; that it cannot be said only where most objects have no name. Nonsense: nothing may be shown.
- Another language: the right object, or that English alone is understood.

Beside that no answer may contradict itself, see `contradictions`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from benchmarks.questions.trained_questions import PhotoObject, Question
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.objects.absence import RATHER
from fastsplat_contract.masks import decode_mask3d
from fastsplat_contract.messages.queries import Answer

_DECIDED = ("here", "probably_here")


@dataclass(frozen=True)
class Truth:
    """What is known of one trained scene."""

    ids: Mapping[str, int]  # by key, the object that each object is
    names: Mapping[int, str]  # by id, the names of all objects; "" for none
    right_names: Mapping[str, Sequence[str]]  # by key

    def named(self, key: str) -> bool:
        """True if an object bears one of its right names."""
        name = label_key(self.names.get(self.ids.get(key, 0), ""))
        return bool(name) and name in {label_key(right_name) for right_name in self.right_names[key]}


def truth_of(objects: Sequence[PhotoObject], ids: Mapping[str, int], names: Mapping[int, str]) -> Truth:
    """What `objects_of` and the scene's own list of objects say."""
    return Truth(ids, names, {obj.key: obj.names for obj in objects})


def is_right(question: Question, answer: Answer, truth: Truth) -> bool:
    """Whether an answer is right, see the module."""
    if question.kind == "count":
        return _count_right(question, answer, truth)
    if question.kind == "foreign" and not _object_ids(answer):
        return "English" in answer.sentence
    if question.kind in ("near", "nonsense", "foreign"):
        return not _object_ids(answer) or (answer.probability is not None and answer.probability < RATHER)
    if question.kind == "far":
        nameless = sum(not name for name in truth.names.values())
        return not _object_ids(answer) and (answer.is_absent or 2 * nameless > len(truth.names))
    return _objects_right(question, answer, truth)


def contradictions(answer: Answer, names: Collection[str]) -> list[str]:
    """What an answer says against itself.

    Args:
        answer: to any text.
        names: that objects of the scene bear, or that are suggested for them.
    """
    said = []
    likely, phrase = answer.probability, answer.phrase
    refused = phrase is not None and phrase.refusal is not None
    if likely is not None and likely < 0.5 and answer.outcome in ("here", "not_here"):
        said.append(f"{answer.outcome} at {likely:.2f}")
    if answer.is_absent and answer.presence is not None and answer.presence > 0.5:
        said.append(f"absent with a presence of {answer.presence:.2f}")
    if answer.is_absent and (answer.object_ids or refused):
        said.append("absent, and objects are shown, or nothing was decided")
    if answer.outcome in _DECIDED and not answer.object_ids:
        said.append(f"{answer.outcome}, and nothing is shown")
    if refused and (answer.outcome in _DECIDED or likely is not None):
        said.append("nothing was decided, and an outcome or a probability of something else stands beside it")
    if answer.outcome in _DECIDED and answer.matches and not answer.matches[0].relevant and not phrase:
        said.append("the first match is none")
    if answer.is_absent and label_key(answer.text) in {label_key(name) for name in names}:
        said.append("a name of the scene is not here")
    known = {label_key(match.label) for match in answer.matches}
    if label_key(answer.text) in known and (
        "no name here is it" in answer.sentence or "none of the" in answer.sentence
    ):
        said.append("a name of the scene is none")
    if (
        phrase is not None
        and phrase.count is not None
        and not phrase.count <= len(answer.object_ids) <= 99 * phrase.count
    ):
        said.append("a number of other objects than are shown")
    for relevant in (False,) if phrase else (False, True):
        figures = [
            match.relevancy if match.probability is None else match.probability
            for match in answer.matches
            if match.relevant is relevant
        ]
        if figures != sorted(figures, reverse=True):
            said.append("matches that no figure orders")
    counts = [match.gaussian_count for match in answer.matches if match.relevant]
    inside = int(decode_mask3d(answer.mask3d, "bits", answer.gaussians).sum()) if answer.mask3d else sum(counts)
    if counts and not 0 < min(counts) <= max(counts) <= inside <= (answer.gaussians if phrase else sum(counts)):
        said.append(f"relevant names of {counts} Gaussians, and a mask of {inside}")
    return said


def _object_ids(answer: Answer) -> tuple[int, ...]:
    return answer.object_ids if answer.outcome in _DECIDED else ()


def _objects_right(question: Question, answer: Answer, truth: Truth) -> bool:
    object_ids = _object_ids(answer)
    ids = {truth.ids[key] for key in question.keys if key in truth.ids}
    accepted = ids | {truth.ids[key] for key in question.also if key in truth.ids}
    if not question.keys:
        return not object_ids and (answer.is_absent or answer.outcome == "cannot_say")
    if object_ids:
        named = {truth.ids[key] for key in question.keys if truth.named(key)}
        complete = question.kind in ("use", "superlative") or 2 * len(named & set(object_ids)) >= len(named)
        return object_ids[0] in accepted and 2 * len(accepted & set(object_ids)) >= len(object_ids) and complete
    if any(truth.named(key) for key in question.keys):
        return False
    return answer.outcome == "cannot_say" or (answer.searched.unnamed_objects > 0 and "no name" in answer.sentence)


def _count_right(question: Question, answer: Answer, truth: Truth) -> bool:
    phrase = answer.phrase
    if phrase is None:
        return False
    if phrase.count is not None:
        return phrase.count == question.count
    ids = {truth.ids[key] for key in question.keys if truth.named(key)}
    return not _object_ids(answer) and len(ids) < len(question.keys or ("nothing",))
