"""Application of edits: a scene in, a new scene out; `_KINDS` lists all kinds.

An edit includes the Gaussians that the object encloses, whatever their label: where two objects touch, a Gaussian of
one often has the label of the other and would stay behind as a floater."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fastsplat.service.query.edits.edited_rows import Rows, edited_rows
from fastsplat.service.query.edits.gaussian_edits import duplicate, move, recolor, remove
from fastsplat.service.query.edits.insertion import insert_objects
from fastsplat.service.query.edits.object_edits import edit_objects
from fastsplat.service.query.edits.prompted_objects import make_prompted_object
from fastsplat.service.query.edits.suggested_names import suggest_names
from fastsplat.service.scene.artefact.scene import Objects, Scene
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotFoundError
from fastsplat_contract.geometry.camera import check_rigid
from fastsplat_contract.masks import pack_bits
from fastsplat_contract.messages.edit_previews import EditPreview
from fastsplat_contract.messages.scenes import Edit

if TYPE_CHECKING:
    from fastsplat.service.query.scene_index import SceneIndex


@dataclass(frozen=True)
class _Order:
    """The arguments of `apply_edit`."""

    index: SceneIndex
    edit: Edit
    seen: Objects | None
    before: Objects
    source: SceneIndex | None
    max_gaussians: int | None
    piece: Rows | None


@dataclass(frozen=True)
class _Kind:
    """A kind of edit."""

    make: Callable[[_Order], Scene]  # the scene afterwards
    needs: tuple[str, ...] = ()  # the fields of an edit without which it makes no sense
    takes: tuple[str, ...] = ()  # those that it may have. No other kind takes either
    named: bool = False  # whether it may give a name


def apply_edit(
    index: SceneIndex,
    edit: Edit,
    seen: Objects | None = None,
    before: Objects | None = None,
    source: SceneIndex | None = None,
    *,
    max_gaussians: int | None = None,
    piece: Rows | None = None,
) -> Scene:
    """Applies an edit and returns the new scene; the index's own scene is unchanged.

    Evidence, codes and objects follow their rows. A scene without stored objects stores them from its first edit on, so
    that their ids persist.

    Args:
        seen: the objects that the editor has looked at; None: unknown.
        before: the objects before the request that the edit is part of; None: those of the index.
        source: index of the scene that `insert` takes objects from.
        max_gaussians: bound for duplicates, each of which can double the scene; None for no bound.
        piece: int64 [K]: the Gaussians that the prompt of `split` or `add` shows.

    Raises:
        NotFoundError: no such label or object here.
        InvalidInputError: an unknown action, not exactly one of label and objects, or an invalid field.
        LimitExceededError: the scene would be too large, or see `edit_objects`.
        ConflictError: see `edit_objects`.
    """
    if edit.action in _CALLS or edit.texts:
        what, call = _CALLS.get(edit.action, _CALLS["look_again"])
        raise InvalidInputError(
            f"{what} is no edit", field="texts" if edit.texts else "action", hint=f"{call} is a call of its own."
        )
    kind = _KINDS.get(edit.action)
    if kind is None:
        raise InvalidInputError(f"no edit {edit.action!r}", field="action", hint=f"Use {', '.join(_KINDS)}.")
    _check_fields(edit, kind)
    return kind.make(_Order(index, edit, seen, before or index.objects.table, source, max_gaussians, piece))


def _check_fields(edit: Edit, kind: _Kind) -> None:
    for name, value in (
        ("color", edit.color),
        ("transform", edit.transform),
        ("source", edit.source),
        ("prompt", edit.prompt),
        ("known_lengths", edit.known_lengths or edit.known_sizes or None),
        ("alignment", edit.alignment),
        ("filter", edit.filter),
        ("suggestions", edit.suggestions or None),
    ):
        if (value is not None) != (name in kind.needs) and name not in kind.takes:
            raise InvalidInputError(
                f"{edit.action} {'needs' if name in kind.needs else 'takes no'} {name}",
                field=name,
                hint="See the edit's fields.",
            )
    if not kind.named and (edit.name is not None or edit.aliases or edit.kinds):
        raise InvalidInputError(f"{edit.action} takes no name", field="name", hint="See the edit's fields.")
    if edit.transform is not None:
        check_rigid(edit.transform.matrix(), field="transform")
    if edit.color is not None:
        color = np.asarray(edit.color, dtype=np.float64)
        if color.shape != (3,) or not ((color >= 0) & (color <= 1)).all():
            raise InvalidInputError(f"a color of {edit.color}", field="color", limit="RGB, 0 to 1 each")


def _changed(scene: Scene, action: str) -> Scene:
    """Records an action that makes the scene deviate from its photos."""
    before = scene.facts.changed_by
    if action in before:
        return scene
    return replace(scene, facts=replace(scene.facts, changed_by=(*before, action)))


def _of_rows(change: Callable[[Scene, Rows, Edit], Scene], *, grows: bool = False) -> Callable[[_Order], Scene]:
    """Makes a kind that changes the Gaussians it is about; `grows`: check their number."""

    def make(order: _Order) -> Scene:
        rows = edited_rows(order.index, order.edit)
        count = len(order.index.scene.gaussians) + len(rows)
        if grows and order.max_gaussians is not None and count > order.max_gaussians:
            raise LimitExceededError(
                f"{count} Gaussians with this duplicate",
                field="action",
                limit=f"{order.max_gaussians} Gaussians of a scene",
                hint="Duplicate smaller objects, or remove some first.",
            )
        return _changed(change(order.index.objects.scene, rows, order.edit), order.edit.action)

    return make


def _remove(order: _Order) -> Scene:
    """Removes Gaussians; refused if nothing would be left or a filter takes nothing."""
    edit, count = order.edit, len(order.index.scene.gaussians)
    rows = edited_rows(order.index, edit)
    if len(rows) == count or (edit.filter is not None and not len(rows)):
        said = {"filter": edit.filter, "label": edit.label, "object_ids": edit.object_ids or None}
        raise InvalidInputError(
            f"this removes {'all' if len(rows) else 'none'} of {count} Gaussians",
            field=next(name for name, value in said.items() if value is not None),
            hint="PreviewEdit tells what an edit would remove.",
        )
    return _changed(remove(order.index.objects.scene, rows), edit.action)


def _prompted(order: _Order) -> Scene:
    assert order.piece is not None
    return make_prompted_object(order.index, order.edit, order.piece, order.seen, order.before)


def _insert(order: _Order) -> Scene:
    assert order.source is not None
    return _changed(insert_objects(order.index, order.source, order.edit), "insert")


def _scale(order: _Order) -> Scene:
    from fastsplat.service.query.edits.scale_edits import scale_scene  # torch loads with the first measurement

    return scale_scene(order.index, order.edit)


def _align(order: _Order) -> Scene:
    from fastsplat.service.query.edits.aligning import align_scene  # scipy.stats loads with the first alignment

    return align_scene(order.index, order.edit)


_CALLS = {"look_again": ("looking again", "LookAgain"), "observe": ("an observation", "ObserveScene")}
"""Actions found in versions but not sent as edits: description and call."""
_OF_OBJECTS = _Kind(lambda order: edit_objects(order.index, order.edit, order.seen, order.before))
_KINDS: Mapping[str, _Kind] = {
    "recolor": _Kind(_of_rows(recolor), ("color",)),
    "remove": _Kind(_remove, takes=("filter",)),
    "move": _Kind(_of_rows(move), ("transform",)),
    "duplicate": _Kind(_of_rows(duplicate, grows=True), ("transform",)),
    "name": replace(_OF_OBJECTS, named=True),
    "unname": _OF_OBJECTS,
    "merge": _OF_OBJECTS,
    "discard": _OF_OBJECTS,
    "split": _Kind(_prompted, ("prompt",), named=True),
    "add": _Kind(_prompted, ("prompt",), named=True),
    "insert": _Kind(_insert, ("transform", "source")),
    "scale": _Kind(_scale, ("known_lengths",)),
    "align": _Kind(_align, ("alignment",)),
    "suggest": _Kind(lambda order: suggest_names(order.index.objects, order.edit.suggestions), ("suggestions",)),
}


def preview_of(index: SceneIndex, version: str, edits: Sequence[Edit]) -> EditPreview:
    """Computes the Gaussians that edits would remove, each applied after those before it.

    Errors as `edited_rows`, with the field inside `edits`; other actions raise InvalidInputError."""
    left = np.arange(len(index.scene.gaussians))
    gone = np.zeros(len(left), np.bool_)
    counts = []
    for number, edit in enumerate(edits):
        try:
            if edit.action != "remove":
                raise InvalidInputError(
                    f"{edit.action} has no preview", field="action", hint="Send edits whose action is remove."
                )
            rows = edited_rows(index, edit)
            gone[left[rows]] = True
            counts.append(len(rows))
            if len(rows) == len(left):
                counts += [0] * (len(edits) - number - 1)
                break
            if len(rows) and number + 1 < len(edits):
                index = index.after(apply_edit(index, edit))
                left = np.delete(left, rows)
        except (InvalidInputError, NotFoundError) as error:
            raise error.within(f"edits[{number}]") from error
    return EditPreview(version, len(gone), int(gone.sum()), tuple(counts), pack_bits(gone))
