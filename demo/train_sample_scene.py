"""Trains the sample scene that the product brings: `make sample-scene`.

The capture in `demo/sample` goes through the stages of the service with its own poses, in meters, and its own label
maps; bounded by steps, with a seed, so that the same machine and models make the same scene. Objects are discovered
(`FASTSPLAT_DISCOVERY__OBJECTS=on`), so that two books on each other are two. The default models must be there.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import tempfile
import zipfile
from collections import Counter
from pathlib import Path

_CAPTURE = Path(__file__).resolve().parent / "sample"
_MOST_BYTES = 3_000_000
_TRAINING = {"time_budget_s": None, "iterations": 4_000, "max_gaussians": 14_000, "max_sh_degree": 1}
_SETTINGS = {
    "FASTSPLAT_TRAINING": json.dumps(_TRAINING),
    "FASTSPLAT_DISCOVERY__OBJECTS": "on",
    "FASTSPLAT_JOBS__NICENESS": "0",  # nobody else waits for this machine
    "FASTSPLAT_PHOTOS__MAX_SIDE": "320",
    "FASTSPLAT_PHOTOS__QUALITY": "75",
}
_DATE = (1980, 1, 1, 0, 0, 0)


def main() -> None:
    """Train the scene, and write it where the package has it."""
    os.environ |= _SETTINGS  # before they are read
    from fastsplat.service.library.training_run import train
    from fastsplat.service.settings import load_settings
    from fastsplat.service.store.care.backup import back_up
    from fastsplat.service.store.care.sample_scene import SAMPLE_ARCHIVE
    from fastsplat.service.store.store import open_store

    parser = argparse.ArgumentParser(prog="python -m demo.train_sample_scene", description=__doc__)
    parser.add_argument("--out", type=Path, default=SAMPLE_ARCHIVE)
    out = parser.parse_args().out
    with tempfile.TemporaryDirectory() as work:
        capture, data, saved = Path(work) / "sample", Path(work) / "data", Path(work) / "saved"
        for part in ("images", "masks"):
            shutil.copytree(_CAPTURE / part, capture / part)
        poses = {**json.loads((_CAPTURE / "transforms.json").read_text()), "units": "meters"}
        (capture / "transforms.json").write_text(json.dumps(poses))
        with train(capture, data, name="sample") as scene:
            info, objects = scene.info, scene.objects()
            print(scene, {name: info.quality[name] for name in ("psnr",) if name in info.quality})
            print(dict(Counter(obj.name or "(no name)" for obj in objects)))
        store = open_store(data, "", load_settings().artefacts)
        try:
            back_up(store, data, "", saved)
        finally:
            store.close()
        pack(saved, Path(work) / "scene.zip")
        archive = Path(work) / "scene.zip"
        size = archive.stat().st_size
        if size > _MOST_BYTES:
            raise SystemExit(f"{size} bytes are more than the {_MOST_BYTES} that a wheel is to carry")
        shutil.copyfile(archive, out)
        print(f"{out}: {size} bytes")


def pack(saved: Path, target: Path) -> None:
    """A backup as the archive that `unpack_sample` reads: without the PLY file, and without dates."""
    from fastsplat.service.store.care.sample_scene import PLY_NAME

    with zipfile.ZipFile(target, "w") as archive:
        for path in sorted(saved.rglob("*")):
            if path.is_file() and path.name != PLY_NAME:
                entry = zipfile.ZipInfo(path.relative_to(saved).as_posix(), _DATE)
                entry.compress_type = zipfile.ZIP_LZMA
                archive.writestr(entry, path.read_bytes())


if __name__ == "__main__":
    main()
