"""Encodes and validates things as rows of `scene.json`."""

from __future__ import annotations

import base64
from dataclasses import asdict, replace
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from fastsplat.service.scene.artefact.reads import MAX_READ_CHARS, MOST_READS
from fastsplat.service.scene.artefact.scene import Looks, NameSource, SurfaceKind, Thing, ThingGroup
from fastsplat.service.scene.artefact.suggestions import Suggestion
from fastsplat_contract.messages.thing_reads import ReadKind, ThingRead

_Share = Annotated[float, Field(ge=0, le=1)]
_Words = Annotated[tuple[str, ...], Field(strict=False)]
_Pair = Annotated[tuple[str, _Share], Field(strict=False)]
_Told = Annotated[tuple[str, _Share, str, str, _Words], Field(strict=False)]
_Suggestion = _Pair | _Told
"""The source is omitted for suggestions of the scene's own models."""

_Line = Annotated[str, Field(min_length=1, max_length=MAX_READ_CHARS)]
_Read = Annotated[tuple[ReadKind, _Line, _Share, Annotated[int, Field(ge=1)]], Field(strict=False)]
_Cameras = Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(strict=False)]


def _is_base64(text: str) -> str:
    base64.b64decode(text, validate=True)
    return text


_Base64 = Annotated[str, AfterValidator(_is_base64)]


class StrictRow(BaseModel):
    """Base of JSON rows: no unknown fields, no type coercion."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class ThingRow(StrictRow):
    """A thing, or a part of one."""

    id: Annotated[int, Field(ge=1, le=65535)]
    name: str
    source: NameSource | None
    probability: _Share
    consensus: _Share
    surface: SurfaceKind
    suggestions: Annotated[tuple[_Suggestion, ...], Field(strict=False)]
    parent: Annotated[int, Field(ge=0, le=65535)]
    appearance: _Base64 = ""
    picture: _Base64 = ""
    proposed_in: _Cameras = ()
    missed_in: _Cameras = ()
    reads: Annotated[tuple[_Read, ...], Field(strict=False, max_length=MOST_READS)] = ()
    looks: Annotated[tuple[str, _Base64], Field(strict=False)] | None = None

    @model_validator(mode="after")
    def _names_have_a_source(self) -> ThingRow:
        if bool(self.name) != (self.source is not None):
            raise ValueError(f"the thing {self.id} has a name without a source, or the other way round")
        return self


class GroupRow(StrictRow):
    """A group of things."""

    id: Annotated[int, Field(ge=1, le=65535)]
    members: Annotated[tuple[int, ...], Field(strict=False, min_length=2)]
    consensus: _Share


class _Parts(StrictRow):
    table: list[ThingRow]
    entries: Annotated[int, Field(ge=0)]
    sha256: str


class ThingsRow(StrictRow):
    """Things of a scene with their parts and groups."""

    table: list[ThingRow]
    next_id: Annotated[int, Field(ge=0, le=65536)]
    entries: Annotated[int, Field(ge=0)]
    sha256: str
    classes: Annotated[int, Field(ge=1)] | None
    parts: _Parts | None
    groups: list[GroupRow]

    @model_validator(mode="after")
    def _ids_ascend(self) -> ThingsRow:
        ids = [thing.id for thing in self.table]
        if ids != sorted(set(ids)):
            raise ValueError("the things' ids do not ascend")
        return self

    @model_validator(mode="after")
    def _parts_are_of_things(self) -> ThingsRow:
        own = [thing.id for thing in self.table]
        parts = [] if self.parts is None else self.parts.table
        ids = [part.id for part in parts]
        if ids != sorted(set(ids)) or set(ids) & set(own):
            raise ValueError("the parts' ids do not ascend, or are those of things")
        if any(thing.parent for thing in self.table) or not {part.parent for part in parts} <= set(own):
            raise ValueError("a part is of no thing, or a thing of another")
        return self

    @model_validator(mode="after")
    def _groups_are_of_things(self) -> ThingsRow:
        own = {thing.id for thing in self.table}
        parts = set() if self.parts is None else {part.id for part in self.parts.table}
        ids = [group.id for group in self.groups]
        if ids != sorted(set(ids)) or set(ids) & (own | parts):
            raise ValueError("the groups' ids do not ascend, or are those of things or parts")
        for group in self.groups:
            if list(group.members) != sorted(set(group.members)) or not set(group.members) <= own:
                raise ValueError(f"the members of group {group.id} do not ascend, or are no things")
        return self


def thing_row(thing: Thing) -> dict[str, Any]:
    """Encodes a thing as JSON with base64 bytes; omits most empty fields."""
    row = asdict(replace(thing, looks=None))
    del row["looks"]
    if thing.looks is not None:
        row["looks"] = thing.looks.sha256, base64.b64encode(thing.looks.embedding).decode()
    for name in ("appearance", "picture"):
        if coded := base64.b64encode(row.pop(name)).decode():
            row[name] = coded
    for name in ("proposed_in", "missed_in", "reads"):
        if not row[name]:
            del row[name]
    row["suggestions"] = [tuple(each) if each.source else each[:2] for each in thing.suggestions]
    return row


def thing_of_row(row: ThingRow) -> Thing:
    """Decodes the output of `thing_row`."""
    decoded = {name: base64.b64decode(getattr(row, name)) for name in ("appearance", "picture")}
    suggestions = tuple(Suggestion(*each) for each in row.suggestions)
    reads = tuple(ThingRead(*each) for each in row.reads)
    looks = None if row.looks is None else Looks(row.looks[0], base64.b64decode(row.looks[1]))
    return Thing(**{**vars(row), **decoded, "suggestions": suggestions, "reads": reads, "looks": looks})


def group_of_row(row: GroupRow) -> ThingGroup:
    """Decodes a group from its `asdict` form."""
    return ThingGroup(row.id, row.members, row.consensus)
