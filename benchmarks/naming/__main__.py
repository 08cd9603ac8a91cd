"""A person's time to name twelve drawn rooms whole, by what a captioner suggests.

    python -m benchmarks.naming [ROOM ...] --models DIR [--views 12]

A stand-in for a model answers each contact sheet of objects with the truth, but for one object in ten, all with 90 %.
What it says is suggested as the server's captioner suggests it. Then a person goes through the objects one by one on
the page: Enter where the name in the field is right, else the right name and Enter. Objects are the true ones, as
    points on their
surfaces, and sheets are cut from drawn photos: what is measured is naming, not discovery.

  objects: that a sheet shows, floors and walls aside; reached: those whose true name is suggested, in `first` as the
  likeliest; stated: objects that bear a name before the person has confirmed any; named: those that bear the true one
  in the end; obeyed: names that would be suggested if a captioner called everything "cat", as a poster says;
  keystrokes,
  seconds: of the person, by the keystroke-level model of Card, Moran and Newell (1980): 1.35 s to decide about an
  object, 0.28 s a key; wrong_at_once: names that are wrong where all of 80 % and more are taken at once, which takes
  one key.

`two` has the same where two such models err independently.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.provenance import RESULTS, begin, parser_of, provenance, write_json
from benchmarks.reads.labels import true_objects
from benchmarks.rooms.arranging import Room
from benchmarks.rooms.drawing import ROOMS, Studio, camera_of, room_of
from benchmarks.rooms.pictures import phone_faults, photo_of
from benchmarks.rooms.truth import RoomView
from fastsplat.service.capture.photos.scene_photos import photo_path
from fastsplat.service.common.dictionary import Dictionary, label_key
from fastsplat.service.jobs.nameless_objects import said_by, sheets_of
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Scene, SemanticHead
from fastsplat.service.settings import CaptionerSettings, load_settings
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.messages.scenes import Edit
from tests.client.replay_captioner import named, replayed

_TWELVE = (*ROOMS["validation"], *ROOMS["test"])
_CHOSEN_ON = "nothing was chosen by these figures"
_DECIDES_S, _KEY_S = 1.35, 0.28
_SAYS, _WRONG_OF = 0.9, 10
_FILLED_IN, _AT_ONCE = 0.5, 0.8
"""From what probability the page fills a name in, and from what it offers to take all."""
_POINTS = 20_000


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("rooms", nargs="*", metavar="ROOM", help="; ".join(_TWELVE))
    parser.add_argument("--models", type=Path, required=True, help="model directory")
    parser.add_argument("--views", type=int, default=12, help="photos of a room")
    options = parser.parse_args()
    start = begin()
    encoder = open_text_encoder(load_settings().perception.text_encoder, options.models)
    rooms = {}
    for name in options.rooms or _TWELVE:
        room, seed = room_of(name)
        with tempfile.TemporaryDirectory(prefix="fastsplat-") as folder:
            index = drawn_index(room, Studio(room, seed).draw, seed, options.views, Path(folder), encoder)
            single, two = (named_room(index, room, Path(folder), seed, count) for count in (1, 2))
        rooms[name] = {**single, "two": two}
        print(name, rooms[name], flush=True)
    rows = list(rooms.values())
    document = {"rooms": rooms, **summed(rows), "two": summed([row["two"] for row in rows])}
    print({name: value for name, value in document.items() if name != "rooms"})
    write_json(RESULTS / "naming.json", {**provenance(start, settings=options, chosen_on=_CHOSEN_ON), **document})


def drawn_index(
    room: Room, draw: Callable[[PosedCamera], RoomView], seed: int, views: int, folder: Path, encoder: TextEncoder
) -> SceneIndex:
    """A room whose true objects are known and have no names, with so many photos, evenly spread, in a version's folder;
    the seed is of their faults."""
    camera, rng = camera_of(), np.random.default_rng([seed, 1])
    size = np.sort(np.ptp(np.concatenate([mesh.points for obj in room.objects for mesh in obj.meshes]), axis=0))
    gaussians, objects = true_objects(room, float(np.sqrt(size[1] * size[2] / _POINTS)))
    posed = []
    for number, pose in enumerate(room.poses[:: max(1, len(room.poses) // views)][:views]):
        view = draw(PosedCamera(camera, pose, f"{number:03d}.jpg"))
        path = photo_path(folder, number)
        path.parent.mkdir(exist_ok=True)
        Image.fromarray(photo_of(view.light, phone_faults(rng), rng)).save(path, quality=92)
        posed.append(view.posed)
    scene = Scene(
        gaussians=gaussians,
        head=SemanticHead.unlearnt(0),
        dictionary=Dictionary(()),
        label_embeddings=np.zeros((0, encoder.encode(["object"]).shape[1]), np.float32),
        text_encoder=(encoder.name, encoder.sha256),
        cameras=tuple(posed),
        scale="METRIC",
        objects=objects,
    )
    return SceneIndex(scene, encoder)


def named_room(index: SceneIndex, room: Room, folder: Path, seed: int, captioners: int) -> dict[str, Any]:
    """A room of `drawn_index` named by a person, whom so many captioners help, with errors by this seed."""
    truth = {number: obj.label for number, obj in enumerate(room.objects, start=1)}
    sheets = list(sheets_of(index, folder, "drawn"))
    object_ids = [obj.object_id for sheet in sheets for obj in sheet.objects]
    refused = 0
    for number in range(captioners):
        seen = with_errors({obj: truth[obj] for obj in object_ids}, [seed, number])
        with replayed(sheets, partial(named, names=seen, probability=_SAYS)) as server:
            said = said_by(CaptionerSettings(url=server.url, model=f"model {number}"), sheets)
        refused += said.refused
        if said.names:
            index = index.after(apply_edit(index, Edit("suggest", suggestions=said.names)))
    stated = sum(bool(obj.name) for obj in index.objects.listed)
    with replayed(sheets, partial(named, names=dict.fromkeys(object_ids, "cat"))) as server:
        obeyed = said_by(CaptionerSettings(url=server.url, model="obeys"), sheets).names
    by_hand = [obj for obj in index.objects.listed if obj.id in object_ids and obj.kind == "object"]
    suggestions = {obj.id: obj.suggestions for obj in by_hand}
    first = {object_id: suggestions[object_id][0] for object_id in suggestions if suggestions[object_id]}
    right = {
        object_id: label_key(suggestion.name) == label_key(truth[object_id]) for object_id, suggestion in first.items()
    }
    keys = 1  # begins
    for obj in by_hand:
        filled = right.get(obj.id, False) and first[obj.id].probability >= _FILLED_IN
        keys += 1 if filled else len(truth[obj.id]) + 1
        index = index.after(apply_edit(index, Edit("name", object_ids=(obj.id,), name=truth[obj.id])))
    names = {obj.id: obj.name for obj in index.objects.listed}
    keyed = [{label_key(suggestion.name) for suggestion in suggestions[object_id]} for object_id in suggestions]
    return {
        "objects": len(by_hand),
        "reached": sum(
            label_key(truth[object_id]) in names_told for object_id, names_told in zip(suggestions, keyed, strict=True)
        ),
        "first": sum(right.values()),
        "refused": refused,
        "stated": stated,
        "obeyed": len(obeyed),
        "named": sum(label_key(names[object_id]) == label_key(truth[object_id]) for object_id in suggestions),
        "keystrokes": keys,
        "seconds": round(_DECIDES_S * (1 + len(by_hand)) + _KEY_S * keys, 1),
        "wrong_at_once": sum(first[object_id].probability >= _AT_ONCE and not right[object_id] for object_id in first),
    }


def with_errors(truth: Mapping[int, str], seed: Sequence[int]) -> dict[int, str]:
    """The names of objects, one in ten of them another object's or "umbrella"."""
    rng = np.random.default_rng(seed)
    wrong = set(rng.choice(list(truth), -(-len(truth) // _WRONG_OF), replace=False).tolist())
    names = sorted({*truth.values(), "umbrella"})
    return {
        obj: str(rng.choice([other_name for other_name in names if other_name != name])) if obj in wrong else name
        for obj, name in truth.items()
    }


def summed(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """All rooms together, and the room that took longest."""
    counts = [name for name in rows[0] if name not in ("seconds", "two")]
    total = {name: sum(row[name] for row in rows) for name in counts}
    seconds = [row["seconds"] for row in rows]
    return {
        **total,
        "reached_share": round(total["reached"] / total["objects"], 4),
        "seconds": round(sum(seconds), 1),
        "seconds_of_longest": max(seconds),
    }


if __name__ == "__main__":
    _main()
