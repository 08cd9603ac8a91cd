"""How often a name that people gave in some drawn rooms is suggested for the right objects of others.

    python -m benchmarks.known_names [ROOM ...] --keep FOLDER

The objects of each room are discovered in a scene that was trained without labels; a discovered object bears the name
of the true one that it is, by pixels of the test views. In the six validation rooms all are named; what then is
suggested in the six test rooms, whose objects are other objects, is compared with the truth. Rooms whose folder lies in
FOLDER are not drawn and trained again, see `benchmarks.rooms`. Rooms of the test split alone are counted: the rule was
chosen on the others, each compared with the five others.

  nameable: discovered objects of a kind that is known; suggested: objects for which a name is, of any kind or none;
  right: those whose name it is; suggested_80, right_80: those of at least 80 %;
  `one` has the same where one kind alone is known, by at most three objects, each kind in turn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.objects.discovered import settings_by_steps
from benchmarks.provenance import RESULTS, begin, parser_of, provenance, write_json
from benchmarks.rooms.__main__ import kept_room, with_objects
from benchmarks.rooms.drawing import ROOMS, room_of
from benchmarks.rooms.figures import measured
from benchmarks.rooms.truth import read_truth
from fastsplat.service.instances.naming.object_appearances import with_appearances
from fastsplat.service.perception.appearance import open_appearance_encoder
from fastsplat.service.query.objects.names.look_alikes import Sizes, sizes_in_meters
from fastsplat.service.query.objects.names.names_from_scenes import KnownObject, described, names_by_looks
from fastsplat.service.scene.artefact.scene import Object, Objects
from fastsplat.service.settings import Settings

_CHOSEN_ON = "the six validation rooms, each compared with the five others"
_EXAMPLES = 3
_LIKELY = 0.8
_NO_KIND = ("floor", "wall")


class FoundRoom(NamedTuple):
    """The objects that were discovered in a room.

    Attributes:
        name: of the room.
        objects: with descriptors, where a view shows them well.
        sizes: see `sizes_in_meters`.
        kinds: what each is, by id; objects that are no true one are not among them.
    """

    name: str
    objects: Objects
    sizes: Sizes
    kinds: Mapping[int, str]


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("rooms", nargs="*", metavar="ROOM", help="; ".join(ROOMS["test"]))
    parser.add_argument("--keep", type=Path, required=True, help="folder of the rooms")
    parser.add_argument("--iterations", type=int, default=2500)
    parser.add_argument("--gaussians", type=int, default=30_000)
    options = parser.parse_args()
    start = begin()
    settings = settings_by_steps(options.iterations, options.gaussians)
    known = [example for name in ROOMS["validation"] for example in examples(found_room(name, options.keep, settings))]
    rows, kind_rows = {}, {}
    for name in options.rooms or ROOMS["test"]:
        room = found_room(name, options.keep, settings)
        rows[name] = count_suggestions(room, known)
        kind_rows[name] = summed([count_suggestions(room, by_kind) for by_kind in one_kind_each(known)])
        print(name, rows[name], kind_rows[name], flush=True)
    document = {"rooms": rows, **summed(list(rows.values())), "one": summed(list(kind_rows.values()))}
    print({name: value for name, value in document.items() if name != "rooms"})
    about = provenance(start, settings=options, chosen_on=_CHOSEN_ON)
    write_json(RESULTS / "known_names.json", {**about, **document})


def found_room(name: str, keep: Path, settings: Settings) -> FoundRoom:
    """A room's objects, discovered and described as a job does it; see `kept_room`."""
    folder = keep / name
    dataset, capture, scene, labelling = kept_room(name, folder, settings)
    found = with_objects(scene, capture, labelling, settings)
    assert found.objects is not None
    compared = measured(found, dataset, read_truth(folder / "drawn" / "truth.npz"))
    encoder = open_appearance_encoder(settings.perception, settings.models)
    objects = with_appearances(found.objects, found.gaussians, capture.views, encoder, settings.training.max_side)
    labels = [obj.label for obj in room_of(name)[0].objects]
    kinds = {objects.table[place].id: labels[number - 1] for number, place in compared.matches().items()}
    sizes = sizes_in_meters(replace(found, objects=objects, scale="METRIC"))  # rooms are drawn in meters
    return FoundRoom(
        name, objects, sizes, {object_id: kind for object_id, kind in kinds.items() if kind not in _NO_KIND}
    )


def examples(room: FoundRoom) -> list[KnownObject]:
    """What is known when a person has named all objects of a room."""
    looks = described(room.objects, room.sizes)
    return [
        KnownObject(room.name, room.kinds[object_id], looks[object_id])
        for object_id in sorted(room.kinds)
        if object_id in looks
    ]


def one_kind_each(known: Sequence[KnownObject]) -> list[list[KnownObject]]:
    """At most `_EXAMPLES` of each kind, by itself."""
    return [
        [example for example in known if example.name == kind][:_EXAMPLES]
        for kind in sorted({example.name for example in known})
    ]


def count_suggestions(room: FoundRoom, known: Sequence[KnownObject]) -> dict[str, int]:
    """What is suggested for a room's objects, counted."""
    objects: list[Object] = [obj for obj in room.objects.table if obj.appearance]
    names = names_by_looks(objects, known, room.sizes)
    right = {object_id for object_id, name in names.items() if room.kinds.get(object_id) == name.name}
    likely = {object_id for object_id, name in names.items() if name.probability >= _LIKELY}
    kinds = {example.name for example in known}
    return {
        "nameable": sum(room.kinds.get(obj.id) in kinds for obj in objects),
        "suggested": len(names),
        "right": len(right),
        "suggested_80": len(likely),
        "right_80": len(likely & right),
    }


def summed(rows: Sequence[Mapping[str, int]]) -> dict[str, int]:
    """All together."""
    return {name: int(np.sum([row[name] for row in rows])) for name in rows[0]}


if __name__ == "__main__":
    _main()
