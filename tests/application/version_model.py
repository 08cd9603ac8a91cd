"""What calls on the versions of one scene have to do, in as few words as can be: a tree, a place in it, and a bound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

Content: TypeAlias = tuple[int, ...]  # the color of each label, as a number
Expected: TypeAlias = str  # name of the version that must be current; "" for any


@dataclass(frozen=True)
class EditCall:
    """Give a label a color; requests of the same id are one request."""

    label: int
    color: int
    request_id: str


@dataclass(frozen=True)
class StepCall:
    """Undo or redo."""

    action: Literal["undo", "redo"]
    expected: Expected


@dataclass(frozen=True)
class RestoreCall:
    """Make a version current."""

    version: str
    expected: Expected


@dataclass(frozen=True)
class JobCall:
    """End a job that made a version of `parent`."""

    parent: str


Call: TypeAlias = EditCall | StepCall | RestoreCall | JobCall


@dataclass(frozen=True)
class Acknowledged:
    """The version that an answer names, and of which it was made."""

    version: str
    parent: str


Answer: TypeAlias = Acknowledged | Literal["conflict", "not found"]


@dataclass(frozen=True)
class Known:
    """A version; `left` counts when it last ceased to be current, 0: never."""

    parent: str
    content: Content
    left: int = 0


@dataclass(frozen=True)
class History:
    """The versions of a scene by name, oldest first, and which one is current."""

    versions: Mapping[str, Known]
    current: str
    limit: int
    requests: Mapping[str, tuple[EditCall, str]] = field(default_factory=dict)
    moment: int = 0

    def after(self, call: Call, answer: Answer) -> History | None:
        """What is after a call that was answered so; None if that answer is wrong."""
        if isinstance(call, EditCall):
            return self._edited(call, answer)
        if isinstance(call, JobCall):
            return self._worked(call, answer)
        if call.expected and call.expected != self.current:
            return self if answer == "conflict" else None
        if isinstance(call, RestoreCall):
            if call.version not in self.versions:
                return self if answer == "not found" else None
            target = call.version
        elif call.action == "undo":
            target = self.versions[self.current].parent
        else:
            children = [name for name, known in self.versions.items() if known.parent == self.current]
            target = max(children, key=lambda name: self.versions[name].left, default="")
            ties = [name for name in children if self.versions[name].left == self.versions[target].left]
            target = ties[-1] if ties else ""
        if not target:
            return self if answer == "conflict" else None
        return self._at(target) if answer == Acknowledged(target, self.versions[target].parent) else None

    def lineage(self) -> list[str]:
        """The current version and all that it was made of."""
        names = [self.current]
        while parent := self.versions[names[-1]].parent:
            names.append(parent)
        return names

    def _edited(self, call: EditCall, answer: Answer) -> History | None:
        earlier_call, version = self.requests.get(call.request_id, (call, ""))
        if version in self.versions:  # the id is known as long as its version is there
            if earlier_call != call or version not in self.lineage():
                return self if answer == "conflict" else None
            return self if answer == Acknowledged(version, self.versions[version].parent) else None
        if not isinstance(answer, Acknowledged):
            return None
        content = list(self.versions[self.current].content)
        content[call.label] = call.color
        after = self._published(answer.version, self.current, tuple(content))
        if after is None or after.versions[answer.version].parent != answer.parent:
            return None
        return replace(after, requests={**after.requests, call.request_id: (call, answer.version)})

    def _worked(self, call: JobCall, answer: Answer) -> History | None:
        if call.parent != self.current:
            return self if answer == "conflict" else None
        if not isinstance(answer, Acknowledged):
            return None
        return self._published(answer.version, call.parent, self.versions[call.parent].content)

    def _published(self, name: str, parent: str, content: Content) -> History | None:
        if name in self.versions:
            return None
        more = replace(self, versions={**self.versions, name: Known(parent, content)})
        return more._at(name)._bounded(name)

    def _at(self, name: str) -> History:
        if name == self.current:
            return self
        left = replace(self.versions[self.current], left=self.moment + 1)
        return replace(
            self, versions={**self.versions, self.current: left}, current=name, moment=self.moment + 1
        )  # fmt: skip

    def _bounded(self, newest: str) -> History:
        in_force, names = self.lineage(), list(self.versions)
        order = [name for name in names if name not in in_force] + [name for name in names if name in in_force]
        candidates = [name for name in order if name not in (names[0], self.current, newest)]
        removed = candidates[: max(0, len(names) - self.limit)]
        versions = {}
        for name, known in self.versions.items():
            parent = known.parent
            while parent in removed:
                parent = self.versions[parent].parent
            if name not in removed:
                versions[name] = replace(known, parent=parent)
        return replace(self, versions=versions)
