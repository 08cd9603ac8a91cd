"""Suggested names: searchable and shown, but not given to objects."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

from fastsplat.service.query.objects.names.merged_suggestions import OWN_SOURCE, TAG_SOURCE
from fastsplat.service.query.objects.object_index import SceneObjects
from fastsplat.service.scene.artefact.scene import Object, Scene
from fastsplat.service.scene.artefact.suggestions import MOST_SUGGESTED, Suggestion, ranked_suggestions
from fastsplat.service.scene.objects.objects import checked_name
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from fastsplat_contract.jobs.name_suggestions import SuggestedName

MAX_SUGGESTED = 1_000
"""Names in one edit."""
_MAX_ALIASES = 20
_MAX_SOURCE = 60
_OWN_SOURCES = (OWN_SOURCE, TAG_SOURCE, "person")
"""Names of the scene's own sources in answers."""


def suggest_names(objects: SceneObjects, suggested: Sequence[SuggestedName]) -> Scene:
    """Adds suggested names; a source's new suggestions for an object replace its earlier ones.

    Raises:
        NotFoundError: no such object or part here.
        InvalidInputError: an invalid name, alias, source or probability; names the field.
        LimitExceededError: too many names, or too many of one source for one object.
    """
    if len(suggested) > MAX_SUGGESTED:
        raise LimitExceededError(
            f"{len(suggested)} names", field="suggestions", limit=f"{MAX_SUGGESTED} names", hint="Send several batches."
        )
    objects.check_all([suggestion.object_id for suggestion in suggested], "suggestions")
    by_object: defaultdict[int, list[Suggestion]] = defaultdict(list)
    for number, name in enumerate(suggested):
        field = f"suggestions[{number}]"
        by_object[name.object_id].append(_checked(name, field))
        count = sum(entry.source == name.source.strip() for entry in by_object[name.object_id])
        if count > MOST_SUGGESTED:
            raise LimitExceededError(
                f"{count} names of one source for object {name.object_id}", field=field, limit=f"{MOST_SUGGESTED} names"
            )

    def changed(obj: Object) -> Object:
        new = by_object.get(obj.id, [])
        sources = {suggestion.source for suggestion in new}
        rest = [suggestion for suggestion in obj.suggestions if suggestion.source not in sources]
        return replace(obj, suggestions=ranked_suggestions([*new, *rest])) if new else obj

    scene = objects.scene
    parts = scene.objects.parts
    if parts is not None:
        parts = replace(parts, table=tuple(map(changed, parts.table)))
    return replace(scene, objects=replace(scene.objects, table=tuple(map(changed, scene.objects.table)), parts=parts))


def _checked(guess: SuggestedName, field: str) -> Suggestion:
    source, model = (
        checked_name(text, f"{field}.{name}") if text or name == "source" else ""
        for name, text in (("source", guess.source), ("model", guess.model))
    )
    if source in _OWN_SOURCES or len(source) > _MAX_SOURCE:
        raise InvalidInputError(
            f"a source {source[:80]!r}",
            field=f"{field}.source",
            limit=f"1 to {_MAX_SOURCE} characters, and neither {' nor '.join(_OWN_SOURCES)}",
            hint="Say who suggests the name.",
        )
    if not 0.0 <= guess.probability <= 1.0:
        raise InvalidInputError(f"a probability of {guess.probability}", field=f"{field}.probability", limit="0 to 1")
    if (count := len(guess.aliases)) > _MAX_ALIASES:
        raise LimitExceededError(f"{count} aliases", field=f"{field}.aliases", limit=f"{_MAX_ALIASES} aliases")
    aliases = tuple(checked_name(word, f"{field}.aliases[{n}]") for n, word in enumerate(guess.aliases))
    return Suggestion(checked_name(guess.name, f"{field}.name"), guess.probability, source, model, aliases)
