"""Second look for more names: choice of views, and use of their votes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.instances.discovery.lifting import lift_regions_of
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.instances.naming.naming import LEAST_SUGGESTED, MOST_SEEN, SEEN_PX
from fastsplat.service.scene.artefact.scene import Gaussians, Object, Objects
from fastsplat.service.scene.artefact.suggestions import Suggestion, ranked_suggestions
from fastsplat.service.scene.objects.objects import object_rows
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.training_views import training_size
from fastsplat_contract.geometry.camera import PosedCamera

F64 = NDArray[np.float64]

_NAMED_WORTH = 0.5  # worth of seeing a named object, relative to an unnamed one
_LOOSE_WORTH = 1.0  # worth of seeing all Gaussians without an object
_RIVALS = 0.5  # a text is clear only if other names have at most this share of its probability


@torch.no_grad()
def shares_seen(
    gaussians: Gaussians,
    objects: Objects,
    cameras: Sequence[PosedCamera],
    settings: DiscoverySettings,
    on_view: Callable[[int, int], None] = lambda done, total: None,
    *,
    backend: Backend = "cpu",
) -> F64:
    """Share of each object's Gaussians that each view sees, float64 [V, T + 1].

    Objects are in the order of the table; the last column is for Gaussians without an object.
    """
    place = np.full(max((obj.id for obj in objects.table), default=0) + 1, len(objects.table), np.int64)
    place[[obj.id for obj in objects.table]] = np.arange(len(objects.table))
    owner = place[object_rows(objects)]
    whole = np.maximum(np.bincount(owner, minlength=len(objects.table) + 1), 1)
    splats = splats_of(gaussians, device=device_of(backend))
    shares = np.zeros((len(cameras), len(objects.table) + 1))
    for number, posed in enumerate(cameras):
        camera = training_size(posed.camera, settings.max_side)
        viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32))
        nothing = np.zeros((camera.height, camera.width), np.int32)
        seen = lift_regions_of(splats, viewmat, camera, nothing, 0, backend=backend).pixels > SEEN_PX
        shares[number] = np.bincount(owner[seen], minlength=len(whole)) / whole
        on_view(number + 1, len(cameras))
    return shares


def choose_views(shares: F64, named: Sequence[bool], limit: int) -> list[int]:
    """Chooses at most `limit` views that together see most, unnamed objects first.

    Greedy: each view adds most to the sum over objects (named ones count half) of the share seen, halved for every
    earlier view that sees most of the object. Views that see nothing are not chosen.

    Args:
        shares: [V, T + 1], see `shares_seen`.
        named: of T objects, True for those with a name.
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
    """Objects after a second look."""

    objects: Objects
    named: tuple[int, ...]  # ids of objects now named by one of the texts
    suggested: tuple[int, ...]  # ids of others with one of the texts as a suggestion


def add_names(objects: Objects, sighted: Mapping[int, Mapping[str, float]], *, name_probability: float) -> NamesAdded:
    """Names objects by texts that are clear, and suggests the others.

    A text is clear from `name_probability`, 0..1, if no other text, name or suggestion of the object is nearly as
    probable. Names of persons and label maps stay; a detector's name is replaced only by a clear one, and becomes a
    suggestion.

    Args:
        sighted: probability, 0..1, of each text by object id; unknown ids are ignored.
    """
    named, suggested, table = [], [], []
    for obj in objects.table:
        texts = {name: sure for name, sure in sighted.get(obj.id, {}).items() if sure >= LEAST_SUGGESTED}
        changed = obj
        if texts and obj.source not in ("person", "given"):
            changed = _judged(obj, texts, name_probability)
        keys = {label_key(name) for name in texts}
        if changed is not obj and changed.name and label_key(changed.name) in keys:
            named.append(obj.id)
        elif changed is not obj and keys & {label_key(suggestion.name) for suggestion in changed.suggestions}:
            suggested.append(obj.id)
        table.append(changed)
    return NamesAdded(replace(objects, table=tuple(table)), tuple(named), tuple(suggested))


def _judged(obj: Object, texts: Mapping[str, float], name_probability: float) -> Object:
    by_key = {label_key(name): (name, sure) for name, sure in texts.items()}
    own_key = label_key(obj.name) if obj.name else ""
    best = max(by_key, key=lambda key: by_key[key][1])
    sure = by_key[best][1]
    rivals = [rival for key, (_, rival) in by_key.items() if key not in (best, own_key)]
    if own_key not in ("", best):
        rivals.append(max(obj.probability, by_key.get(own_key, ("", 0.0))[1]))
    extras = [suggestion for suggestion in obj.suggestions if suggestion.source]
    earlier = [(suggestion.name, suggestion.probability) for suggestion in obj.suggestions if not suggestion.source]
    before = [chance for name, chance in earlier if label_key(name) != best]
    clear = sure >= name_probability and max(rivals, default=0.0) <= _RIVALS * sure
    clear = clear and max(before, default=0.0) <= sure
    pool: dict[str, tuple[str, float]] = {}
    stated = ((obj.name, obj.probability),) if obj.name else ()
    for name, chance in (*stated, *earlier, *by_key.values()):
        first, most = pool.get(label_key(name), (name, 0.0))
        pool[label_key(name)] = (first, max(most, chance))
    if clear or own_key == best:
        name, most = pool.pop(best)
        probability = most if own_key == best else sure
        return replace(
            obj, name=name, source="detected", probability=probability, suggestions=_suggestions(pool.values(), extras)
        )
    if own_key:
        name, most = pool.pop(own_key)
        return replace(obj, probability=most, suggestions=_suggestions(pool.values(), extras))
    return replace(obj, suggestions=_suggestions(pool.values(), extras))


def _suggestions(names: Iterable[tuple[str, float]], extras: Sequence[Suggestion]) -> tuple[Suggestion, ...]:
    return ranked_suggestions([*(Suggestion(name, sure) for name, sure in names), *extras])
