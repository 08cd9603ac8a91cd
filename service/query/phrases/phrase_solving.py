"""Resolves parsed questions to objects by measurements, keeping undecided ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import combinations, product

import numpy as np

from fastsplat.service.query.objects.color_names import UNMEASURED, basic_name, color_clearness
from fastsplat.service.query.objects.object_measures import ObjectMeasures, ObjectShape
from fastsplat.service.query.phrases.phrases import (
    SEEN_FROM,
    ColorWord,
    Named,
    OrderKind,
    Phrase,
    Possession,
    Rank,
    Relation,
    Says,
    SizeKind,
    SizeWord,
)
from fastsplat.service.query.phrases.relations import (
    NEED_VERTICAL,
    PAIRS,
    Asker,
    Judged,
    Measured,
    clearness,
    gap_between,
    is_between,
    is_in,
    is_seen,
    negated,
)
from fastsplat.service.query.phrases.stacks import PairBudget, Stacks
from fastsplat.service.query.phrases.written_words import WrittenWords
from fastsplat.service.scene.artefact.scene import Object
from fastsplat_contract.messages.phrases import Refusal, RefusalReason, Witness

_MAX_PAIRS = 64
_MAX_WITNESSES = 200
READ = "read"
"""Witness measure: probability that words are written on an object."""

_Compared = tuple[Judged, tuple[int, ...]]  # a judgement, and ids of the objects that were compared
_Judge = Callable[[int], _Compared]
"""Judges a condition of an object, and names the objects it was measured to."""

_RATIO = float(np.log(1.1))
"""Least log ratio at which sizes or distances differ."""
_LARGE, _NOT_LARGE = float(np.log(1.3)), float(np.log(1.1))
_CLOSEST = 0.5
"""Clearness by which the closest color must lead."""
_APART = 0.5
"""Share of two objects' half widths below which they overlap in the picture."""

_NEED_LEVEL: frozenset[str] = frozenset({"height", "width", "elevation"})

_SIZES: Mapping[str, Callable[[ObjectShape], tuple[float, ...]]] = {
    "size": lambda shape: (float(np.linalg.norm(shape.size)), float(np.prod(shape.size)) ** (1 / 3)),
    "height": lambda shape: (shape.high - shape.low,),
    "length": lambda shape: (max(shape.size),),
    "width": lambda shape: (shape.size[0],),
}
"""Measures by size; "size" has two, and the largest must be so by both.

The two are the diagonal and the cube root of the volume; their average must be clear enough."""


@dataclass(frozen=True)
class Solved:
    """Result of one reading of a question."""

    objects: tuple[int, ...]  # ids of those that fulfil everything; in their order, if it asks for one
    undecided: Mapping[int, Refusal]  # by id, what could not be decided of it
    witnesses: tuple[Witness, ...]  # by which measurements
    refusal: Refusal | None  # why nothing at all could be decided; None otherwise
    named: Named  # what the head names
    doubt: str = ""  # what is not sure of the objects; "" for nothing


class _UndecidableError(Exception):
    def __init__(self, reason: RefusalReason, part: str) -> None:
        super().__init__(part)
        self.refusal = Refusal(reason, part)


@dataclass
class _State:
    """Candidates of a phrase, with their least clearness so far."""

    clear: dict[int, float]
    why: dict[int, Refusal] = field(default_factory=dict)

    def left(self) -> list[int]:
        return [object_id for object_id, clear in self.clear.items() if clear > -1]

    def take(self, object_id: int, judged: Judged, part: str) -> None:
        """Applies a condition."""
        if -1 < judged.clearness < 1 and object_id not in self.why:
            self.why[object_id] = Refusal(judged.reason, part)
        self.clear[object_id] = min(self.clear[object_id], judged.clearness)


@dataclass
class PhraseSolver:
    """Solver for the objects of one scene, one question and one asker."""

    open_measures: Callable[[], ObjectMeasures]  # loads measures; called only if something must be measured
    objects: Mapping[int, Object]  # of the scene that are there, by id; parts, too
    names: Mapping[str, Named]  # what noun groups name, by group and by head; "" is anything
    asker: Asker | None  # where the asker stands; None if that was not said
    unit: str  # of lengths: "m" or "unit"
    written: WrittenWords  # what is written on the objects
    _witnesses: list[Witness] = field(default_factory=list)
    _doubt: str = ""

    def __post_init__(self) -> None:
        self._budget = PairBudget()
        self._pairs: dict[tuple[str, int, int], Judged] = {}

    @cached_property
    def measures(self) -> ObjectMeasures:
        return self.open_measures()

    @cached_property
    def _stacks(self) -> Stacks:
        return Stacks(self.measures, self.objects, self._budget)

    def solve(self, phrase: Phrase) -> Solved:
        """Solves one reading."""
        self._witnesses, self._doubt = [], ""
        named = self._named(phrase)
        try:
            objects, undecided = self._resolve(phrase, named)
        except _UndecidableError as error:
            return Solved((), {}, self._limited(()), error.refusal, named)
        refusal = next(iter(undecided.values())) if undecided and not objects else None
        return Solved(objects, undecided, self._limited((*objects, *undecided)), refusal, named, self._doubt)

    def _limited(self, object_ids: Iterable[int]) -> tuple[Witness, ...]:
        """Keeps a limited number of witnesses, those of these objects first."""
        first = set(object_ids)
        ordered = sorted(self._witnesses, key=lambda witness: witness.object_id not in first)
        return tuple(ordered[:_MAX_WITNESSES])

    def _named(self, phrase: Phrase) -> Named:
        group = self.names.get(phrase.group, Named((), by_name=False))
        if phrase.head and group.whole:
            return group
        head = self.names.get(phrase.head, Named((), by_name=False))
        return replace(head, whole=False)

    def _resolve(self, phrase: Phrase, named: Named | None = None) -> tuple[tuple[int, ...], dict[int, Refusal]]:
        named = named or self._named(phrase)
        shapes = {object_id: shape for object_id in named.ids if (shape := self.measures.shape(object_id)) is not None}
        if not shapes:
            raise _UndecidableError("not_named", phrase.head)
        state = _State(dict.fromkeys(shapes, 10.0))
        said = phrase.group.casefold().split() if named.whole else []
        for color in phrase.colors:
            if color.name not in said or color.negated:
                self._judge_all(state, color.text, partial(self._colored, color))
        state.clear = dict(sorted(state.clear.items(), key=lambda pair: -pair[1]))  # the reddest of all that is red
        self._take_closest(state, phrase)
        for size in phrase.sizes:
            if size.word not in said:
                self._judge_all(state, size.word, partial(self._sized, size, shapes))
        for condition in phrase.conditions:
            if isinstance(condition, Possession):
                self._possession(state, condition)
            elif isinstance(condition, Says):
                self._says(state, condition)
            else:
                self._relation(state, condition)
        if phrase.rank is not None:
            return self._ranked(phrase.rank, state, shapes)
        decided = tuple(object_id for object_id in state.left() if state.clear[object_id] >= 1)
        return decided, {object_id: state.why[object_id] for object_id in state.left() if object_id not in decided}

    def _judge_all(self, state: _State, part: str, judge: _Judge) -> None:
        for object_id in state.left():
            judged, compared_ids = judge(object_id)
            state.take(object_id, judged, part)
            self._witness(part, object_id, compared_ids, judged.measured)

    def _witness(self, part: str, object_id: int, compared_ids: tuple[int, ...], measured: Sequence[Measured]) -> None:
        for measure, value, unit, clear in measured:
            unit = self.unit if unit == "length" else unit
            self._witnesses.append(Witness(part, object_id, compared_ids, measure, value, unit, clear))

    def _colored(self, word: ColorWord, object_id: int) -> _Compared:
        color = self.measures.color(object_id)
        if color is None or word.name in UNMEASURED:
            return Judged(0.0, (), "not_measured"), ()
        share = color.shares[basic_name(word.name)]
        distance, clear = color_clearness(color.lab, color.spread, share, word.name, word.shade)
        return negated(Judged(clear, (Measured("color_distance", distance, "delta_e", clear),)), word.negated), ()

    def _take_closest(self, state: _State, phrase: Phrase) -> None:
        """If nothing clearly has a color, takes the closest, with a doubt."""
        denied = any(color.negated for color in phrase.colors)
        left = {} if denied else {object_id: state.clear[object_id] for object_id in state.left()}
        if near := _closest_in_color(left, len(state.clear), not phrase.head):
            state.clear |= dict.fromkeys(left, -1.0) | dict.fromkeys(near, 1.0)
            self._doubt = f"nothing here is clearly {phrase.colors[0].text}, and that comes closest"

    def _sized(self, word: SizeWord, shapes: Mapping[int, ObjectShape], object_id: int) -> _Compared:
        self._check_vertical(word.by, word.word)
        rivals = {rival_id: shape for rival_id, shape in shapes.items() if rival_id != object_id}
        return _is_large(word.by, word.more, shapes[object_id], tuple(rivals.values())), tuple(rivals)

    def _relation(self, state: _State, relation: Relation) -> None:
        kind, part = relation.kind, relation.text
        if kind in NEED_VERTICAL and self.measures.up is None:
            raise _UndecidableError("vertical_unknown", part)
        if relation.is_of_pose and self.asker is None:
            raise _UndecidableError("pose_needed", part)
        if not relation.anchors:
            self._judge_all(state, part, lambda object_id: (self._by_asker(object_id, relation), ()))
            return
        anchors = [self._anchors(anchor) for anchor in relation.anchors]
        if kind == "between":
            self._judge_all(state, part, lambda object_id: self._between(object_id, relation, anchors))
            return
        ids, only_one = anchors[0], relation.anchors[0].definite
        self._judge_all(state, part, lambda object_id: self._related(object_id, relation, ids, only_one))

    def _anchors(self, phrase: Phrase) -> tuple[int, ...]:
        """Resolves the objects that a relation refers to, or raises _UndecidableError."""
        try:
            objects, undecided = self._resolve(phrase)
        except _UndecidableError as error:
            if error.refusal.reason != "not_named":
                raise
            raise _UndecidableError("referent_absent", error.refusal.part or phrase.group) from None
        if not objects:
            refusal = next(iter(undecided.values()), Refusal("referent_absent", phrase.group or phrase.head))
            raise _UndecidableError(*refusal)
        return objects

    def _related(self, object_id: int, relation: Relation, anchors: Sequence[int], only_one: bool) -> _Compared:
        """Judges a relation to any anchor; for a definite anchor all must agree."""
        judged = {anchor: self._pair(object_id, anchor, relation) for anchor in anchors if anchor != object_id}
        if not judged:
            return Judged(-10.0), ()
        best = max(judged, key=lambda anchor: judged[anchor].clearness)
        result = judged[best]
        if only_one and len(judged) > 1:
            least = min(judgement.clearness for judgement in judged.values())
            if result.clearness >= 1 and least < 1:
                result = Judged(0.0, result.measured, "ambiguous_referent")
        return negated(result, relation.negated), (best,)

    def _pair(self, object_id: int, anchor: int, relation: Relation) -> Judged:
        key = (relation.kind, object_id, anchor)
        if key not in self._pairs:
            self._budget.spend()
            self._pairs[key] = self._judged(object_id, anchor, relation)
        return self._pairs[key]

    def _judged(self, object_id: int, anchor: int, relation: Relation) -> Judged:
        subject, anchor_shape = self._shape(object_id), self._shape(anchor)
        if relation.kind in SEEN_FROM:
            assert self.asker is not None
            return is_seen(relation.kind, subject, anchor_shape, self.asker)
        if relation.kind == "on":
            return self._stacks.rests_on(subject, anchor_shape)
        return PAIRS[relation.kind](subject, anchor_shape)

    def _between(self, object_id: int, relation: Relation, anchors: Sequence[tuple[int, ...]]) -> _Compared:
        ends: Iterable[tuple[int, ...]] = combinations(anchors[0], 2) if len(anchors) == 1 else product(*anchors)
        pairs = [pair for pair in ends if pair[0] != pair[1]]
        if not pairs:
            raise _UndecidableError("referent_absent", relation.text)
        pairs = [pair for pair in pairs if object_id not in pair][:_MAX_PAIRS]
        if not pairs:
            return Judged(-10.0), ()
        judged: dict[tuple[int, ...], Judged] = {}
        for pair in pairs:
            self._budget.spend()
            subject, first, second = map(self._shape, (object_id, *pair))
            judged[pair] = is_between(subject, first, second, self.measures.up is not None)
        best = max(judged, key=lambda pair: judged[pair].clearness)
        return negated(judged[best], relation.negated), best

    def _by_asker(self, object_id: int, relation: Relation) -> Judged:
        assert self.asker is not None
        if relation.kind not in SEEN_FROM:
            return Judged(0.0, (), "not_measured")
        return negated(is_seen(relation.kind, self._shape(object_id), None, self.asker), relation.negated)

    def _says(self, state: _State, says: Says) -> None:
        """Judges writing; photos may not show it, so its absence everywhere is undecided."""
        bearing = self.written.bearing(says.words)
        if bearing.keys().isdisjoint(state.clear):
            raise _UndecidableError("not_read", says.text)

        def judge(object_id: int) -> _Compared:
            clear = 10.0 if object_id in bearing else -10.0
            measured = (Measured(READ, bearing.get(object_id, 0.0), "share", clear),)
            return negated(Judged(clear, measured), says.negated), ()

        self._judge_all(state, says.text, judge)

    def _possession(self, state: _State, possession: Possession) -> None:
        """Judges parts, and objects in or on an object.

        Absence is decided only for "with", if the object is elsewhere or all parts have other names; never for
        contents.
        """
        named = [named_id for named_id in self._named(possession.phrase).ids if self.measures.shape(named_id)]

        def judge(object_id: int) -> _Compared:
            part_ids = tuple(part for part in named if self._parent(part) == object_id)
            if part_ids or self._parent(object_id) in named:
                return negated(Judged(10.0, (Measured("part", 1.0, "", 10.0),)), possession.negated), part_ids
            judged, compared_ids = self._with_other(object_id, [whole for whole in named if not self._parent(whole)])
            if judged.clearness < 1:
                parts = [part for part in self.objects.values() if part.parent == object_id]
                denied = judged.clearness <= -1 or (bool(parts) and all(part.name for part in parts))
                if possession.kind != "with" or not denied:
                    judged = Judged(0.0, judged.measured, "not_measured")
                elif judged.clearness > -1:
                    judged = Judged(-2.0, (Measured("part", 0.0, "", -2.0),))
            return negated(judged, possession.negated), compared_ids

        self._judge_all(state, possession.text, judge)

    def _with_other(self, object_id: int, content_ids: Sequence[int]) -> _Compared:
        """Judges if one of these objects is in or on it."""
        holder, judged = self._shape(object_id), {}
        for content_id in content_ids if self.measures.up is not None else ():
            if content_id != object_id:
                self._budget.spend()
                content = self._shape(content_id)
                ways = is_in(content, holder), self._stacks.direct(content, holder)
                judged[content_id] = max(ways, key=lambda judgement: judgement.clearness)
        if not judged:
            return Judged(0.0, (), "not_measured"), ()
        nearest = max(judged, key=lambda content_id: judged[content_id].clearness)
        return judged[nearest], (nearest,)

    def _shape(self, object_id: int) -> ObjectShape:
        """Shape of an object that is known to have one."""
        shape = self.measures.shape(object_id)
        assert shape is not None
        return shape

    def _parent(self, object_id: int) -> int:
        return self.objects[object_id].parent if object_id in self.objects else 0

    def _ranked(
        self, rank: Rank, state: _State, shapes: Mapping[int, ObjectShape]
    ) -> tuple[tuple[int, ...], dict[int, Refusal]]:
        """The one of the order, if it is the same with and without undecided candidates."""
        self._check_vertical(rank.by, rank.text)
        if (rank.by == "from_left" or (rank.by == "distance" and not rank.anchors)) and self.asker is None:
            raise _UndecidableError("pose_needed", rank.text)
        anchors: list[ObjectShape] = []
        if rank.anchors:
            referents = self._anchors(rank.anchors[0])
            if rank.anchors[0].definite and len(referents) > 1:
                raise _UndecidableError("ambiguous_referent", rank.text)
            anchors = list(map(self._shape, referents))
        self._budget.spend(len(state.left()) * len(anchors))
        sure = [object_id for object_id in state.left() if state.clear[object_id] >= 1]
        answers = []
        for candidates in (sure, state.left()):
            anchor_ids = {anchor.id for anchor in anchors}
            ids = [object_id for object_id in candidates if object_id not in anchor_ids or rank.by != "distance"]
            may_be = [shapes[object_id] for object_id in ids]
            place, judged = _ranked(rank.by, rank.descending, rank.number, may_be, anchors, self.asker)
            answers.append((None if place is None else ids[place], judged))
        (first, judged), (second, clear) = answers
        if first is None and second is None and judged.clearness >= 1 and clear.clearness >= 1:
            return (), {}
        if first is not None:
            self._witness(rank.text, first, tuple(anchor.id for anchor in anchors), judged.measured)
        if first != second:
            unsure = next((object_id for object_id in state.left() if object_id not in sure), None)
            why = Refusal("too_close", rank.text) if unsure is None else state.why[unsure]
            return (), dict.fromkeys(state.left(), why)
        least = min((judged, clear), key=lambda judgement: judgement.clearness)
        if first is None or least.clearness < 1:
            return (), {object_id: Refusal(least.reason, rank.text) for object_id in state.left()}
        return (first,), {}

    def _check_vertical(self, by: str, part: str) -> None:
        if by in _NEED_LEVEL and self.measures.up is None:
            raise _UndecidableError("vertical_unknown", part)


def _is_large(by: SizeKind, more: bool, subject: ObjectShape, rivals: Sequence[ObjectShape]) -> Judged:
    """Judges if an object is large (or small) compared with the median of the others."""
    if not rivals:
        return Judged(0.0, (), "nothing_to_compare")
    sizes, rest = np.array(_SIZES[by](subject)), np.array([_SIZES[by](rival) for rival in rivals])
    ratios = np.log(np.maximum(sizes, 1e-12) / np.maximum(np.median(rest, axis=0), 1e-12)) * (1 if more else -1)
    measured = tuple(
        Measured(by, float(value), "length", clearness(float(ratio), _LARGE, _NOT_LARGE))
        for value, ratio in zip(sizes, ratios, strict=True)
    )
    clears = [measurement.clearness for measurement in measured]
    least, most = min(clears), max(clears)
    return Judged(least if least > 0 else min(most, 0.0), measured)


def _closest_in_color(clear: Mapping[int, float], among: int, anything: bool) -> tuple[int, ...]:
    """Ids of objects closest to a color none clearly has, closest first; else empty.

    `clear` has the clearness of those of `among` objects that are not denied the color; `anything`: of any kind."""
    most = max(clear.values(), default=1.0)
    near = sorted(clear, key=lambda object_id: -clear[object_id])
    if 0 < most < 1:
        return tuple(object_id for object_id in near if clear[object_id] > max(most - _CLOSEST, 0.0))
    only = anything or (len(near) == 1 and among > 1)  # the others of its kind are denied the color
    return tuple(near) if only and most < 0 else ()


def _ranked(
    by: OrderKind,
    descending: bool,
    number: int,
    shapes: Sequence[ObjectShape],
    anchors: Sequence[ObjectShape],
    asker: Asker | None,
) -> tuple[int | None, Judged]:
    """Index in `shapes` of the requested one (None if too few), and its clearness.

    `number` 1 is the first. A distance is to the nearest of `anchors`, without them to the asker."""
    if number > len(shapes):
        return None, Judged(10.0)
    if by == "from_left":
        assert asker is not None
        return _from_left(descending, number, shapes, asker)
    values = np.array([_values(by, shape, anchors, asker) for shape in shapes])
    keys = -values if descending else values
    orders = keys.argsort(axis=0, kind="stable")
    place = int(orders[number - 1, 0])
    measured = []
    for column in range(values.shape[1]):
        order = orders[:, column].tolist()
        beside = [order[at] for at in (number - 2, number) if 0 <= at < len(order)]
        value = float(values[place, column])
        apart = [10.0]
        for rival in beside:
            distance = abs(value - float(values[rival, column]))
            if by == "elevation":
                heights = [shape.high - shape.low for shape in (shapes[place], shapes[rival])]
                apart.append(2 * distance / max(sum(heights) / 2, 1e-12))
            else:
                ratio = max(value, 1e-9) / max(float(values[rival, column]), 1e-9)
                apart.append(abs(float(np.log(ratio))) / _RATIO)
        clear = min(apart) if order[number - 1] == place else -0.5
        measured.append(Measured(by, value, "length", clear))
    clears = [measurement.clearness for measurement in measured]
    clear = float(np.mean(clears)) if min(clears) >= 0 else min(clears)
    return place, Judged(clear if clear >= 1 else min(clear, 0.99), tuple(measured))


def _values(by: OrderKind, shape: ObjectShape, anchors: Sequence[ObjectShape], asker: Asker | None) -> Sequence[float]:
    if by in _SIZES:
        return _SIZES[by](shape)
    if by == "elevation":
        return (float(shape.center[2]),)
    if anchors:
        referents = [anchor for anchor in anchors if anchor.id != shape.id]
        if not referents:
            return (0.0, 0.0)
        return (
            min(gap_between(shape, referent) for referent in referents),
            min(float(np.linalg.norm(shape.center - referent.center)) for referent in referents),
        )
    assert asker is not None
    nearest = float(shape.tree.query(asker.position)[0])
    return nearest, float(np.linalg.norm(shape.center - asker.position))


def _from_left(descending: bool, number: int, shapes: Sequence[ObjectShape], asker: Asker) -> tuple[int | None, Judged]:
    """Orders objects as in the asker's picture."""
    ends = []
    for shape in shapes:
        offsets = shape.points - asker.position
        ahead = offsets @ asker.forward
        if np.median(ahead) <= 0:
            return None, Judged(0.0, (), "out_of_view")
        ends.append(np.quantile((offsets @ asker.right)[ahead > 0] / ahead[ahead > 0], [0.02, 0.98]))
    middles = np.array([low + high for low, high in ends]) / 2
    halves = np.array([high - low for low, high in ends]) / 2
    order = (-middles if descending else middles).argsort(kind="stable").tolist()
    place = order[number - 1]
    beside = [order[at] for at in (number - 2, number) if 0 <= at < len(order)]
    gaps = np.abs(middles[place] - middles[beside]) / np.maximum(_APART * (halves[place] + halves[beside]), 1e-12)
    clear = float(min(gaps, default=10.0))
    angle = float(np.degrees(np.arctan(middles[place])))
    return place, Judged(min(clear, 10.0), (Measured("direction", angle, "deg", min(clear, 10.0)),))
