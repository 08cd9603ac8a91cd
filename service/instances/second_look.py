"""Looking again at a scene for more names: from which views, and what their votes change."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.instances.lifting import lift_regions_of
from fastsplat.service.instances.naming import LEAST_SUGGESTED, MOST_SEEN, SEEN_PX
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.scene.suggestions import Suggestion, ranked_suggestions
from fastsplat.service.scene.things import thing_rows
from fastsplat.service.scene.types import Gaussians, Thing, Things
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.types import Backend
from fastsplat.service.splatting.training_views import training_size
from fastsplat_contract.camera import PosedCamera

F64 = NDArray[np.float64]

_NAMED_WORTH = 0.5
"""Worth of seeing a thing that has a name, of one that has none."""
_LOOSE_WORTH = 1.0
"""Worth of seeing all that belongs to no thing."""
_RIVALS = 0.5
"""A text is clear only where no other name has more than this share of its probability."""


@torch.no_grad()
def shares_seen(
    gaussians: Gaussians,
    things: Things,
    cameras: Sequence[PosedCamera],
    settings: DiscoverySettings,
    on_view: Callable[[int, int], None] = lambda done, total: None,
    *,
    backend: Backend = "cpu",
) -> F64:
    """float64 [V, T + 1], 0..1: the share of each thing's Gaussians that each view sees, in the order of the table, and
    last of those that belong to no thing.

    Args:
        cameras: V views.
        settings: at which size views are looked at.
    """
    place = np.full(max((thing.id for thing in things.table), default=0) + 1, len(things.table), np.int64)
    place[[thing.id for thing in things.table]] = np.arange(len(things.table))
    owner = place[thing_rows(things)]
    whole = np.maximum(np.bincount(owner, minlength=len(things.table) + 1), 1)
    splats = splats_of(gaussians, device=device_of(backend))
    shares = np.zeros((len(cameras), len(things.table) + 1))
    for number, posed in enumerate(cameras):
        camera = training_size(posed.camera, settings.max_side)
        viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32))
        nothing = np.zeros((camera.height, camera.width), np.int32)
        seen = lift_regions_of(splats, viewmat, camera, nothing, 0, backend=backend).pixels > SEEN_PX
        shares[number] = np.bincount(owner[seen], minlength=len(whole)) / whole
        on_view(number + 1, len(cameras))
    return shares


def choose_views(shares: F64, named: Sequence[bool], limit: int) -> list[int]:
    """Positions of at most `limit` views that together see most of the scene, and of its unnamed things first; the best
    view comes first.

    Each view in turn adds most: the sum over things (named ones count half) of the share that it sees, halved for every
    view before that sees most of the thing. A view that sees nothing is not chosen.

    Args:
        shares: [V, T + 1], see `shares_seen`.
        named: of each of T things, whether it has a name.
        limit: at least 1.
    """
    worth = np.array([*(_NAMED_WORTH if has_name else 1.0 for has_name in named), _LOOSE_WORTH])
    free = np.ones(len(shares), np.bool_)
    chosen: list[int] = []
    while free.any() and len(chosen) < limit:
        gains = np.where(free, shares @ worth, -1.0)
        best = int(gains.argmax())
        if gains[best] <= 0:
            break
        chosen.append(best)
        free[best] = False
        worth = np.where(shares[best] > MOST_SEEN, worth / 2, worth)
    return chosen


@dataclass(frozen=True)
class NamesAdded:
    """Things after a second look.

    Attributes:
        things: the same, some with other names and suggestions.
        named: ids of those whose name is one of the texts by this look.
        suggested: ids of the others that got one of the texts as a suggestion.
    """

    things: Things
    named: tuple[int, ...]
    suggested: tuple[int, ...]


def add_names(things: Things, sighted: Mapping[int, Mapping[str, float]], *, name_probability: float) -> NamesAdded:
    """The same things, named where the look is clear, else with suggestions.

    A text is clear from `name_probability` if no other text, name or suggestion of the thing is nearly as probable.
    Names of persons and of label maps stay; a detector's name stays unless another is clear, and is a suggestion after
    that.

    Args:
        sighted: for ids of things the probability of each text, 0..1; ids that are no thing's are left out.
        name_probability: the bound, 0..1.
    """
    named, suggested, table = [], [], []
    for thing in things.table:
        texts = {name: sure for name, sure in sighted.get(thing.id, {}).items() if sure >= LEAST_SUGGESTED}
        changed = thing
        if texts and thing.source not in ("person", "given"):
            changed = _judged(thing, texts, name_probability)
        keys = {label_key(name) for name in texts}
        if changed is not thing and changed.name and label_key(changed.name) in keys:
            named.append(thing.id)
        elif changed is not thing and keys & {label_key(each.name) for each in changed.suggestions}:
            suggested.append(thing.id)
        table.append(changed)
    return NamesAdded(replace(things, table=tuple(table)), tuple(named), tuple(suggested))


def _judged(thing: Thing, texts: Mapping[str, float], name_probability: float) -> Thing:
    by_key = {label_key(name): (name, sure) for name, sure in texts.items()}
    own = label_key(thing.name) if thing.name else ""
    best = max(by_key, key=lambda key: by_key[key][1])
    sure = by_key[best][1]
    rivals = [other for key, (_, other) in by_key.items() if key not in (best, own)]
    if own not in ("", best):
        rivals.append(max(thing.probability, by_key.get(own, ("", 0.0))[1]))
    told = [each for each in thing.suggestions if each.source]
    earlier = [(each.name, each.probability) for each in thing.suggestions if not each.source]
    before = [other for name, other in earlier if label_key(name) != best]
    clear = sure >= name_probability and max(rivals, default=0.0) <= _RIVALS * sure
    clear = clear and max(before, default=0.0) <= sure
    pool: dict[str, tuple[str, float]] = {}
    stated = ((thing.name, thing.probability),) if thing.name else ()
    for name, other in (*stated, *earlier, *by_key.values()):
        first, most = pool.get(label_key(name), (name, 0.0))
        pool[label_key(name)] = (first, max(most, other))
    if clear or own == best:
        name, most = pool.pop(best)
        probability = most if own == best else sure
        return replace(
            thing, name=name, source="detected", probability=probability, suggestions=_suggestions(pool.values(), told)
        )
    if own:
        name, most = pool.pop(own)
        return replace(thing, probability=most, suggestions=_suggestions(pool.values(), told))
    return replace(thing, suggestions=_suggestions(pool.values(), told))


def _suggestions(names: Iterable[tuple[str, float]], told: Sequence[Suggestion]) -> tuple[Suggestion, ...]:
    return ranked_suggestions([*(Suggestion(name, sure) for name, sure in names), *told])
