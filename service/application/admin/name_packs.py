"""Names as a file for other projects and servers, and how well names are known again in scenes left out."""

from __future__ import annotations

import base64
import time
import uuid
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fastsplat.service.application.base.validate import check_texts
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.things.merged_suggestions import PACK_SOURCE
from fastsplat.service.query.things.names_by_looks import KnownThing, names_by_looks, undescribed
from fastsplat.service.scene.types import Thing
from fastsplat.service.settings import Settings
from fastsplat.service.store.name_repository import PackRecord
from fastsplat_contract.errors import ConflictError, InvalidInputError
from fastsplat_contract.known_names import KindCheck, KnownNamesCheck, NamePack, PackedName

if TYPE_CHECKING:
    from fastsplat.service.query.things.look_alikes import F64

_LENGTH_OFF = 0.02
"""By how much the length of a descriptor may differ from 1: it is stored in float16."""
_MOST_METERS = 1_000.0


def packed(known: Sequence[KnownThing], license_text: str, settings: Settings) -> NamePack:
    """The pack of what people named in a project's scenes.

    Raises:
        InvalidInputError: nothing is known by looks, or the license cannot be stored.
        ModelUnavailableError: see `features_version`.
    """
    check_texts(license_text, "license")
    from fastsplat.service.perception.appearance import SIZE

    own = (each for each in known if not each.source and _is_described(each.appearance, 2 * SIZE))
    names = tuple(PackedName(each.name, each.appearance) for each in own)
    if not names:
        raise InvalidInputError("nothing is known by looks", field="names", hint="Name things in some scenes first.")
    return NamePack(license_text, *_own_features(settings), names)


def checked_pack(pack: NamePack, settings: Settings) -> PackRecord:
    """A pack that can be added, as it is stored.

    Raises:
        ConflictError: it has another model's features than this server's.
        InvalidInputError: a name that is none, or an appearance that is no descriptor of that model.
        ModelUnavailableError: see `features_version`.
    """
    # Here, as servers that use no packs need no model.
    from fastsplat.service.perception.appearance import SIZE

    for field in ("license", "model"):
        check_texts(getattr(pack, field), f"pack.{field}")
    model, digest = _own_features(settings)
    if pack.digest != digest:
        raise ConflictError(
            f"the pack has features of {pack.model!r} ({pack.digest[:12]}), this server those of {model!r} "
            f"({digest[:12]}): they cannot be compared",
            field="pack.digest",
            hint="Make the pack anew on a server with the same detector, or use its detector here.",
        )
    for number, each in enumerate(pack.names):
        check_texts(each.name, f"pack.names[{number}].name")
        if not label_key(each.name) or not each.name.isprintable():
            raise InvalidInputError("no name", field=f"pack.names[{number}].name", limit="words that can be printed")
        if not _is_described(each.appearance, 2 * SIZE):
            raise InvalidInputError(
                "no descriptor",
                field=f"pack.names[{number}].appearance",
                limit=f"{SIZE} finite numbers of length 1 as float16, then none or three from 0 to {_MOST_METERS:g}",
            )
    names = [(each.name, base64.b64encode(each.appearance).decode()) for each in pack.names]
    return PackRecord(uuid.uuid4().hex, pack.license, pack.model, pack.digest, names, time.time())


def known_of(record: PackRecord) -> tuple[KnownThing, ...]:
    """What a pack knows."""
    return tuple(KnownThing("", name, base64.b64decode(looks), source=PACK_SOURCE) for name, looks in record.names)


def checked_names(known: Sequence[KnownThing]) -> KnownNamesCheck:
    """How well names are known again, each scene left out in turn; see `KnownNamesCheck`.

    Args:
        known: all names of a project, those of packs, too.
    """
    lengths = Counter(len(undescribed(each.appearance)[0]) for each in known if each.appearance)
    length = max(lengths, key=lambda one: lengths[one], default=0)  # those of another model compare with nothing
    looks = [each for each in known if each.appearance and len(undescribed(each.appearance)[0]) == length]
    words = {label_key(each.name): each.name for each in reversed(looks)}
    borne, suggested, right = Counter[str](), Counter[str](), Counter[str]()
    for scene_id in sorted({each.scene_id for each in looks if not each.source}):
        others = [each for each in looks if each.source or each.scene_id != scene_id]
        own = [each for each in looks if not each.source and each.scene_id == scene_id]
        bear = dict(enumerate(own, start=1))
        things, sizes = _as_things(bear)
        elsewhere = {label_key(each.name) for each in others}
        told = names_by_looks(things, others, sizes)
        borne.update(key for key in (label_key(each.name) for each in bear.values()) if key in elsewhere)
        suggested.update(label_key(name.name) for name in told.values())
        right.update(
            label_key(name.name) for n, name in told.items() if label_key(name.name) == label_key(bear[n].name)
        )
    examples = Counter(label_key(each.name) for each in looks)
    kinds = tuple(
        KindCheck(words[key], examples[key], borne[key], suggested[key], right[key])
        for key in sorted(words, key=lambda one: words[one])
    )
    return KnownNamesCheck(kinds, borne.total(), suggested.total(), right.total())


def _as_things(bear: dict[int, KnownThing]) -> tuple[list[Thing], dict[int, F64]]:
    things, sizes = [], {}
    for number, each in bear.items():
        appearance, size = undescribed(each.appearance)
        things.append(replace(Thing(number), appearance=appearance))
        if size is not None:
            sizes[number] = size
    return things, sizes


def _is_described(appearance: bytes, length: int) -> bool:
    if len(appearance) not in (length, length + 6):
        return False
    row, size = undescribed(appearance)
    numbers = np.frombuffer(row, np.float16).astype(np.float64)
    whole = np.isfinite(numbers).all() and abs(np.linalg.norm(numbers) - 1) <= _LENGTH_OFF
    return bool(whole and (size is None or ((size >= 0) & (size <= _MOST_METERS)).all()))


def _own_features(settings: Settings) -> tuple[str, str]:
    from fastsplat.service.perception.appearance import features_version

    return features_version(settings.perception, settings.models)
