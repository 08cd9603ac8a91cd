"""The tree of errors is the one that is drawn at its head."""

from __future__ import annotations

from collections.abc import Iterator

from fastsplat_contract import errors
from fastsplat_contract.errors import FastSplatError


def _drawn(root: type[FastSplatError], before: str = "") -> Iterator[str]:
    children = [kind for kind in root.__subclasses__() if kind.__module__ == errors.__name__]
    for kind in children:
        last = kind is children[-1]
        name = f"{before}{'└' if last else '├'}── {kind.__name__}"
        kind_value = kind.kind.value if kind.kind is not root.kind or root is FastSplatError else ""
        yield f"{name:<40}{kind_value:<22}{kind.reason}"
        yield from _drawn(kind, before + ("    " if last else "│   "))


def test_the_drawn_tree_is_the_tree() -> None:
    drawn = [line.removeprefix("    ") for line in (errors.__doc__ or "").splitlines() if "── " in line]
    assert drawn == list(_drawn(FastSplatError))


def test_every_reason_is_one_class() -> None:
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, FastSplatError)]
    assert len({kind.reason for kind in kinds}) == len(kinds)
    for kind in kinds:
        error = kind("no", hint="h", field="f", limit="l").within("edits[2]")
        assert type(error) is kind and error.details() == {"field": "edits[2].f", "limit": "l", "hint": "h"}
