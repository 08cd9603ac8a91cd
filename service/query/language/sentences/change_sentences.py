"""Sentences about changes in a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from fastsplat.service.query.language.sentences.sentences import quoted
from fastsplat_contract.photos.localization import ChangeKind, SceneChange
from fastsplat_contract.photos.observations import Observation


def in_words(observation: Observation, names: Mapping[int, str]) -> Observation:
    """Updates an observation's names and sentences by current names, by object id."""

    def updated(change: SceneChange) -> SceneChange:
        name = names.get(change.object_id, change.name)
        sentence = change_sentence(change.kind, change.object_id, name, change.distance, observation.meters)
        return change._replace(name=name, sentence=sentence)

    changes = tuple(map(updated, observation.changes))
    return replace(observation, changes=changes, sentence=changes_sentence(changes, len(observation.looked_at)))


def changes_sentence(changes: Sequence[SceneChange], looked_at: int) -> str:
    """Sentence of an observation."""
    if changes:
        return " ".join(change.sentence for change in changes)
    objects = "the one object" if looked_at == 1 else f"the {looked_at} objects"
    return f"None of {objects} that were looked at has changed." if looked_at else "The photos show no object twice."


def change_sentence(kind: ChangeKind, object_id: int, name: str, distance: float, meters: bool) -> str:
    """Sentence of one change; `object_id` 0: of no object of the scene."""
    by = f"has moved by {distance:.2f} {'m' if meters else 'scene units'}."
    if not object_id:
        endings = {"gone": "that was here is gone.", "moved": by, "changed": "else stands where something was."}
        return f"Something {endings.get(kind, 'new stands where nothing stood.')}"
    called = f"The {quoted(name)}" if name else f"Object {object_id}, which has no name,"
    if kind == "gone":
        return f"{called} is not where it was."
    if kind == "moved":
        return f"{called} {by}"
    return f"Something else stands where {called[0].lower()}{called[1:]} was."
