"""Draw the rooms on which image-text models are calibrated where they run: `service/jobs/looks_rooms.zip`.

    python -m benchmarks.calibration.draw_rooms

Two rooms of every kind of `benchmarks.rooms`, by seeds that no benchmark measures, and the demo's sample: five whole
views each, with the object of every pixel. `ROOM/N.webp` is a photo, `ROOM/N.png` has its ids from 1, 0 for none;
`rooms.json` has the labels of each room's objects, id 1 first.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from zipfile import ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.provenance import parser_of
from benchmarks.rooms.drawing import KINDS, Studio, camera_of, room_of
from benchmarks.rooms.pictures import phone_faults, photo_of
from fastsplat.service.jobs.looks_rooms import ROOMS_FILE
from fastsplat_contract.geometry.camera import PosedCamera

_SEEDS = (31, 32)
_VIEWS, _WIDTH, _QUALITY = 5, 640, 75
_SAMPLE = Path("demo/sample")

Views = Iterator[tuple[NDArray[np.uint8], NDArray[np.uint8]]]


def _drawn(name: str) -> tuple[list[str], Views]:
    room, seed = room_of(name)
    studio, rng = Studio(room, seed, _WIDTH), np.random.default_rng([seed, 1])
    poses = [room.poses[number] for number in _spread(len(room.poses))]
    views = (studio.draw(PosedCamera(camera_of(_WIDTH), pose, name)) for pose in poses)
    pairs = ((photo_of(view.light, phone_faults(rng), rng), view.objects) for view in views)
    return [obj.label for obj in room.objects], pairs


def _sample() -> tuple[list[str], Views]:
    document = json.loads((_SAMPLE / "transforms.json").read_text())
    frames = [document["frames"][number] for number in _spread(len(document["frames"]))]
    paths = ((_SAMPLE / frame["file_path"], _SAMPLE / frame["instance_path"]) for frame in frames)
    return document["instances"], ((np.asarray(Image.open(a)), np.asarray(Image.open(b))) for a, b in paths)


def _spread(count: int) -> list[int]:
    return [round(at) for at in np.linspace(0, count - 1, _VIEWS)]


def _main() -> None:
    parser_of(__doc__).parse_args()
    names = [f"{kind}-{seed}" for seed in _SEEDS for kind in KINDS]
    labels: dict[str, list[str]] = {}
    with ZipFile(ROOMS_FILE, "w") as archive:
        for name in (*names, "sample"):
            labels[name], views = _sample() if name == "sample" else _drawn(name)
            for number, (photo, ids) in enumerate(views):
                for ending, picture, options in (
                    ("webp", photo, {"quality": _QUALITY}),
                    ("png", ids, {"optimize": True}),
                ):
                    stream = BytesIO()
                    Image.fromarray(picture).save(stream, ending, **options)
                    archive.writestr(ZipInfo(f"{name}/{number}.{ending}"), stream.getvalue())
            print(name, len(labels[name]), flush=True)
        archive.writestr(ZipInfo("rooms.json"), json.dumps(labels))


if __name__ == "__main__":
    _main()
