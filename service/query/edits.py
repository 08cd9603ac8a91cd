"""Edits by name: recolor, remove, move or duplicate what a label, an object or a thing is; name things (see
`thing_edits`). A scene in, another scene out.

An edit takes along what the object encloses, whatever its label: where two objects meet, a Gaussian of the one often
has the label of the other, and would stay behind as a floater.

Rows keep their order, so that a mask of the old version tells what became of it: recoloring and moving change no row
number, removing closes the gaps, duplicates come after all other rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.special import expit

from fastsplat.service.query.objects import MIN_OPACITY, masses
from fastsplat.service.scene.changes import with_change
from fastsplat.service.scene.label_evidence import evidence_of, rows_of
from fastsplat.service.scene.things import (
    MAX_THING_ID,
    next_thing_id,
    thing_rows,
    things_of_rows,
    with_rows_of_no_part,
)
from fastsplat.service.scene.types import F32, SH_C0, Gaussians, Scene, Things
from fastsplat_contract.camera import check_rigid
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotFoundError
from fastsplat_contract.places import Alignment, KnownLength, KnownSize
from fastsplat_contract.scenes import EditAction, InsertSource
from fastsplat_contract.thing_prompts import PROMPTED, ThingPrompt

if TYPE_CHECKING:
    from fastsplat.service.query.scene_index import SceneIndex

F64 = NDArray[np.float64]
Rows = NDArray[np.int64]

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # ITU-R BT.709
_DARK = 0.1
_DIRECTIONS = 64
_NEIGHBORS = 12
_ENCLOSED = 0.5
_MARGIN = 0.25


@dataclass(frozen=True)
class Edit:
    """What to do to everything of a label, to one object, or to things.

    Attributes:
        action: what.
        label: a name of the scene's dictionary (as in its hash table: case, plural and aliases do not matter), or None;
            with it everything of that label is meant, objects and specks.
        object_id: `SceneObject.id`, or None.
        things: ids of things, or none; exactly one of label, object_id and things.
        color: RGB 0..1 for `recolor`, the mean color afterwards; None otherwise.
        transform: float64 [4, 4] for `move` and `duplicate`, the rigid motion x' = R x + t in the world frame, scene
            units; None otherwise.
        name, aliases: for `name`, see `edit_things`.
        source: for `insert`, where the things come from; None otherwise.
        prompt: for `split` and `add`, where the piece or the missing thing is in a picture; None otherwise.
        texts: of versions that looking again made; none for an edit.
        known_lengths, known_sizes: for `scale`; none otherwise.
        alignment: for `align`; None otherwise.
    """

    action: EditAction
    label: str | None = None
    object_id: str | None = None
    color: tuple[float, float, float] | None = None
    transform: NDArray[np.float64] | None = None
    things: tuple[int, ...] = ()
    name: str | None = None
    aliases: tuple[str, ...] = ()
    source: InsertSource | None = None
    prompt: ThingPrompt | None = None
    texts: tuple[str, ...] = ()
    known_lengths: tuple[KnownLength, ...] = ()
    known_sizes: tuple[KnownSize, ...] = ()
    alignment: Alignment | None = None


def apply_edit(
    index: SceneIndex,
    edit: Edit,
    seen: Things | None = None,
    before: Things | None = None,
    source: SceneIndex | None = None,
    *,
    max_gaussians: int | None = None,
    piece: Rows | None = None,
) -> Scene:
    """The scene after the edit; evidence, codes and things go along with their rows. The index's own scene stays as it
    is.

    A scene that stores no things stores them from its first edit on, so that their ids stay.

    Args:
        index: of the scene as it is.
        edit: what to do.
        seen: the things that whoever edits has looked at; None: unknown.
        before: the things before the request that the edit is part of; None: those of the index.
        source: of the scene that `insert` takes things from; None for other edits.
        max_gaussians: no duplicate makes the scene larger than this; None for no bound. Each can double it.
        piece: int64 [K]: the Gaussians that the prompt of `split` or `add` shows; None for other edits.

    Raises:
        NotFoundError: no such label, object or thing here.
        InvalidInputError: an unknown action, not exactly one of label, object_id and things, a color, transform or name
            that is missing, superfluous, out of range or not rigid.
        LimitExceededError, ConflictError: the scene would be too large, or see `edit_things`.
    """
    from fastsplat.service.query.insertion import insert_things
    from fastsplat.service.query.prompted_things import make_prompted_thing
    from fastsplat.service.query.thing_edits import edit_things

    actions: dict[str, Callable[[Scene, Rows, Edit], Scene]] = {
        "recolor": _recolor,
        "remove": _remove,
        "move": _move,
        "duplicate": _duplicate,
    }
    if edit.action in ("look_again", "train_more") or edit.texts:
        raise InvalidInputError(
            "training a scene further is no edit" if edit.action == "train_more" else "looking again is no edit",
            field="texts" if edit.texts else "action",
            hint=f"{'TrainMore' if edit.action == 'train_more' else 'LookAgain'} is a call of its own, and makes an "
            "operation.",
        )
    _check_extras(edit)
    if edit.action in ("name", "unname", "merge", "discard"):
        return edit_things(index, edit, seen, before or index.things.table)
    if edit.action in PROMPTED:
        assert piece is not None
        return make_prompted_thing(index, edit, piece, seen, before or index.things.table)
    if edit.name is not None or edit.aliases:
        raise InvalidInputError(f"{edit.action} takes no name", field="name", hint="See the edit's fields.")
    if edit.action == "scale":
        from fastsplat.service.query.measuring import scale_scene  # torch loads with the first measurement

        return scale_scene(index, edit)
    if edit.action == "align":
        from fastsplat.service.query.aligning import align_scene  # it imports this module

        return align_scene(index, edit)
    if edit.action == "insert":
        assert source is not None
        return with_change(insert_things(index, source, edit), "insert")
    if edit.action not in actions:
        raise InvalidInputError(
            f"no edit {edit.action!r}", field="action", hint=f"Use {', '.join(get_args(EditAction)[:-2])}."
        )
    rows = edited_rows(index, edit)
    count = len(index.scene.gaussians) + len(rows)
    if edit.action == "duplicate" and max_gaussians is not None and count > max_gaussians:
        raise LimitExceededError(
            f"{count} Gaussians with this duplicate",
            field="action",
            limit=f"{max_gaussians} Gaussians of a scene",
            hint="Duplicate smaller things, or remove some first.",
        )
    return with_change(actions[edit.action](index.things.scene, rows, edit), edit.action)


def edited_rows(index: SceneIndex, edit: Edit) -> Rows:
    """int64 [K], ascending: the Gaussians that an edit is about. Those of the label or object, and those they enclose:
    of whose twelve nearest visible neighbors they have half the opacity or more.

    Raises:
        NotFoundError: no such label, object or thing here.
        InvalidInputError: not exactly one of label, object_id and things.
    """
    rows = _named_rows(index, edit)
    gaussians = index.scene.gaussians
    if not len(rows):
        return rows
    opacities = expit(gaussians.logit_opacities.astype(np.float64))
    finite = np.isfinite(gaussians.means).all(axis=1)
    visible = np.flatnonzero(finite & (opacities >= MIN_OPACITY))
    taken = np.zeros(len(gaussians), dtype=np.bool_)
    taken[rows] = True
    around = gaussians.means[np.intersect1d(rows, visible)]
    if not len(around):
        return rows
    low, high = around.min(axis=0), around.max(axis=0)
    candidates = np.flatnonzero(_within(gaussians.means, low, high) & finite & ~taken)
    margin = _MARGIN * (high - low).max()
    visible = visible[_within(gaussians.means[visible], low - margin, high + margin)]
    count = min(_NEIGHBORS, len(visible))
    near = visible[cKDTree(gaussians.means[visible]).query(gaussians.means[candidates], k=[*range(1, count + 1)])[1]]
    shares = (opacities[near] * taken[near]).sum(axis=1) / opacities[near].sum(axis=1)
    taken[candidates[shares >= _ENCLOSED]] = True
    return np.flatnonzero(taken)


def _check_extras(edit: Edit) -> None:
    for name, value, needed in (
        ("color", edit.color, edit.action == "recolor"),
        ("transform", edit.transform, edit.action in ("move", "duplicate", "insert")),
        ("source", edit.source, edit.action == "insert"),
        ("prompt", edit.prompt, edit.action in PROMPTED),
        ("known_lengths", edit.known_lengths or edit.known_sizes or None, edit.action == "scale"),
        ("alignment", edit.alignment, edit.action == "align"),
    ):
        if (value is not None) != needed:
            raise InvalidInputError(
                f"{edit.action} {'needs' if needed else 'takes no'} {name}", field=name, hint="See the edit's fields."
            )
    if edit.transform is not None:
        check_rigid(np.asarray(edit.transform, dtype=np.float64), field="transform")
    if edit.color is not None:
        color = np.asarray(edit.color, dtype=np.float64)
        if color.shape != (3,) or not ((color >= 0) & (color <= 1)).all():
            raise InvalidInputError(f"a color of {edit.color}", field="color", limit="RGB, 0 to 1 each")


def _within(points: F32, low: F32, high: F32) -> NDArray[np.bool_]:
    return np.asarray(((points >= low) & (points <= high)).all(axis=1))


def _named_rows(index: SceneIndex, edit: Edit) -> Rows:
    if (edit.label is not None) + (edit.object_id is not None) + bool(edit.things) != 1:
        raise InvalidInputError(
            "an edit speaks of a label, of an object or of things",
            field="label",
            hint="Send exactly one of label, object_id and things.",
        )
    if edit.label is not None:
        label_id = index.scene.dictionary.id_of(edit.label)
        if label_id is None:
            raise NotFoundError(
                f"no label {edit.label[:80]!r} in this scene", field="label", hint="List the scene's labels."
            )
        return np.flatnonzero(index.labeled((label_id,)))
    if edit.things:
        index.things.check_all(edit.things)
        things = index.things
        return np.flatnonzero(np.isin(things.owner, edit.things) | np.isin(things.part_owner, edit.things))
    for instance in index.instances:
        if instance.object.id == edit.object_id:
            return instance.rows.astype(np.int64)
    raise NotFoundError(
        f"no object {str(edit.object_id)[:80]!r} in this scene", field="object_id", hint="List the scene's objects."
    )


def _remove(scene: Scene, rows: Rows, edit: Edit) -> Scene:
    stays = np.ones(len(scene.gaussians), dtype=np.bool_)
    stays[rows] = False
    return _select(scene, np.flatnonzero(stays))


def _move(scene: Scene, rows: Rows, edit: Edit) -> Scene:
    moved = moved_gaussians(gaussians_of_rows(scene.gaussians, rows), edit.transform)
    return replace(scene, gaussians=_put(scene.gaussians, rows, moved))


def _duplicate(scene: Scene, rows: Rows, edit: Edit) -> Scene:
    count = len(scene.gaussians)
    grown = _select(scene, np.concatenate([np.arange(count), rows]))
    copies = np.arange(count, count + len(rows))
    if scene.things is not None and grown.things is not None:
        grown = replace(grown, things=_copied(scene.things, grown.things, rows))
    moved = moved_gaussians(gaussians_of_rows(grown.gaussians, copies), edit.transform)
    return replace(grown, gaussians=_put(grown.gaussians, copies, moved))


def _copied(before: Things, grown: Things, rows: Rows) -> Things:
    """The things after the Gaussians `rows` were added once more at the end: the copy of a thing, or of what there is
    of it among them, is a thing of its own, with a new id and the same name, and without parts."""
    membership, start = grown.membership, int(grown.membership.starts[len(before.membership)])
    copied = np.unique(thing_rows(before)[rows])
    originals = [thing for thing in before.table if thing.id in copied]
    first = next_thing_id(before)
    if first + len(originals) - 1 > MAX_THING_ID:
        raise LimitExceededError(
            f"{len(originals)} more things", field="things", limit=f"ids up to {MAX_THING_ID}", hint="Merge some first."
        )
    new_ids = np.zeros(max((thing.id for thing in before.table), default=0) + 1, np.uint16)
    for number, thing in enumerate(originals):
        new_ids[thing.id] = first + number
    # No photo shows a copy.
    copies = tuple(replace(thing, id=int(new_ids[thing.id]), proposed_in=(), missed_in=()) for thing in originals)
    labels = np.concatenate([membership.labels[:start], new_ids[membership.labels[start:]]])
    entries = np.repeat(np.arange(len(membership)), np.diff(membership.starts))
    return Things(
        (*before.table, *copies),
        evidence_of(entries, labels, membership.counts, len(membership)),
        first + len(originals),
        None if before.parts is None else with_rows_of_no_part(before.parts, len(membership)),
    )


def _recolor(scene: Scene, rows: Rows, edit: Edit) -> Scene:
    """The luminance of each Gaussian, in every direction, relative to the mean one, times the new color: what was in
    the shade stays there, what glistened glistens. Near black, where ratios mean nothing, differences are kept."""
    part = gaussians_of_rows(scene.gaussians, rows)
    if not len(rows):
        return scene
    target = np.asarray(edit.color, dtype=np.float64)
    luminance = part.sh.astype(np.float64) @ _LUMINANCE  # [K, B], coefficients
    weights = masses(part.log_scales, part.logit_opacities)
    base = 0.5 + SH_C0 * luminance[:, 0]
    mean = float(np.average(base, weights=weights))
    gain = target / max(mean, _DARK)
    sh = luminance[:, :, None] * gain
    sh[:, 0] = (target + (base - mean)[:, None] * gain - 0.5) / SH_C0
    return replace(scene, gaussians=_put(scene.gaussians, rows, replace(part, sh=sh.astype(np.float32))))


def moved_gaussians(part: Gaussians, transform: F64 | None) -> Gaussians:
    """The Gaussians after a rigid motion, float64 [4, 4]: turned, colors included, and shifted."""
    pose = np.asarray(transform, dtype=np.float64)
    turn = Rotation.from_matrix(pose[:3, :3])  # the nearest rotation: the input is one to 1e-3 only
    rotation = turn.as_matrix()
    means = part.means.astype(np.float64) @ rotation.T + pose[:3, 3]
    x, y, z, w = turn.as_quat()
    return replace(
        part,
        means=means.astype(np.float32),
        quats=_multiplied((w, x, y, z), part.quats),
        sh=_rotated_harmonics(part.sh, rotation),
    )


def _multiplied(left: tuple[float, float, float, float], right: F32) -> F32:
    """Hamilton products left ⊗ right [K, 4], w x y z; lengths are those of `right`.

    scipy's product would lose the lengths, and refuses a length of 0.
    """
    w, x, y, z = left
    matrix = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.asarray(right.astype(np.float64) @ matrix.T, dtype=np.float32)


def _rotated_harmonics(sh: F32, rotation: F64) -> F32:
    """Coefficients [K, B, 3] of the same colors seen by a turned object: Σ Y(d) sh' = Σ Y(Rᵀ d) sh for all d.

    Each degree is a space of its own under rotation. Its matrix follows from the basis at more directions than it has
    functions, which is exact up to rounding and needs no formulas for Wigner's matrices.
    """
    import torch

    from fastsplat.service.splatting.raster.harmonics import (
        basis,  # torch loads with the first edit that turns something
    )

    degree = round(sh.shape[1] ** 0.5) - 1
    if degree == 0:
        return sh
    steps = np.arange(_DIRECTIONS) + 0.5
    heights, angles = 1 - 2 * steps / _DIRECTIONS, np.pi * (1 + 5**0.5) * steps  # a Fibonacci sphere
    rims = np.sqrt(1 - heights**2)
    directions = np.stack([rims * np.cos(angles), rims * np.sin(angles), heights], axis=1)
    before = basis(torch.from_numpy(directions @ rotation), degree).numpy()
    after = basis(torch.from_numpy(directions), degree).numpy()
    turned = sh.astype(np.float64)
    for level in range(1, degree + 1):
        band = slice(level**2, (level + 1) ** 2)
        matrix = np.linalg.lstsq(after[:, band], before[:, band], rcond=None)[0]
        turned[:, band] = np.einsum("ab,kbc->kac", matrix, turned[:, band])
    return turned.astype(np.float32)


def gaussians_of_rows(gaussians: Gaussians, rows: Rows) -> Gaussians:
    """The Gaussians `rows` [K], in that order."""
    return Gaussians(
        means=gaussians.means[rows],
        quats=gaussians.quats[rows],
        log_scales=gaussians.log_scales[rows],
        logit_opacities=gaussians.logit_opacities[rows],
        sh=gaussians.sh[rows],
        codes=gaussians.codes[rows],
    )


def _select(scene: Scene, rows: Rows) -> Scene:
    evidence = None if scene.evidence is None else rows_of(scene.evidence, rows)
    things = things_of_rows(scene.things, rows)
    return replace(scene, gaussians=gaussians_of_rows(scene.gaussians, rows), evidence=evidence, things=things)


def _put(gaussians: Gaussians, rows: Rows, part: Gaussians) -> Gaussians:
    means, quats, sh = gaussians.means.copy(), gaussians.quats.copy(), gaussians.sh.copy()
    means[rows], quats[rows], sh[rows] = part.means, part.quats, part.sh
    return replace(gaussians, means=means, quats=quats, sh=sh)
