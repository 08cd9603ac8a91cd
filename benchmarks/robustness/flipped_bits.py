"""Flip random bits of everything that is stored, and look how reading it ends.

`python -m benchmarks.robustness.flipped_bits [TRIALS] [SEED]` prints one JSON object: for each kind of file how many
trials ended well, with a typed error, with an untyped one (named), and how often reading gave other values than before
without an error. Works in a temporary folder.
"""

from __future__ import annotations

import json
import random
import shutil
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fastsplat.service.application.service import open_service
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.scene.ply import read_ply, write_ply
from fastsplat.service.scene.scene_files import read_scene, write_scene
from fastsplat.service.scene.types import Gaussians, Scene, SemanticHead
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from fastsplat.service.store.records import NewJob, SceneSummary
from fastsplat_contract.errors import FastSplatError


def main(trials: int, seed: int) -> None:
    """Print what `trials` flips of each kind of file did."""
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole = folder / "whole"
        _make(whole)
        files: dict[str, Callable[[Path], Any]] = {
            "data/fastsplat.sqlite": lambda copy: _ask_database(copy / "data"),
            "artefact/scene.json": lambda copy: _read_scene(copy / "artefact"),
            "artefact/cameras.json": lambda copy: _read_scene(copy / "artefact"),
            "artefact/gaussians.safetensors": lambda copy: _read_scene(copy / "artefact"),
            "scene.ply": lambda copy: _values(vars(read_ply(copy / "scene.ply"))),
            "checkpoint/training.safetensors": lambda copy: _read_checkpoint(copy / "checkpoint"),
        }
        report = {name: _trials(whole, folder / "copy", name, read, trials, rng) for name, read in files.items()}
    print(json.dumps({"seed": seed, "trials": trials, "files": report}, indent=1))


def _trials(
    whole: Path, copy: Path, name: str, read: Callable[[Path], Any], trials: int, rng: random.Random
) -> dict[str, Any]:
    ended: Counter[str] = Counter()
    expected = read(whole)
    for _ in range(trials):
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(whole, copy)
        data = bytearray((copy / name).read_bytes())
        for _ in range(rng.choice((1, 3, 20))):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        (copy / name).write_bytes(data)
        try:
            ended["same" if read(copy) == expected else "other values, no error"] += 1
        except FastSplatError as error:
            ended[f"typed {error.reason}"] += 1
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            ended[f"UNTYPED {type(error).__name__} in {Path(where.filename).name}: {str(error)[:60]}"] += 1
    return dict(ended.most_common())


def _make(folder: Path) -> None:
    with open_service(Settings(data_dir=folder / "data")) as service:
        store = service._store
        for number in range(20):
            store.scenes.create(NewJob(f"scene{number}", f"op{number}", "desk", f"r{number}", "d", f"up{number}", {}))
            claim = store.jobs.claim(f"op{number}")
            assert claim is not None
            store.jobs.succeed(claim, SceneSummary("v1", 5, "METRIC", (), (), {"psnr": 30.0}, 0))
        service.admin.keys.create("somebody", "admin", None)
    for path in (folder / "data").glob("*-wal"):
        assert not path.stat().st_size
    rng = np.random.default_rng(0)
    gaussians = Gaussians(
        means=rng.normal(size=(500, 3)).astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (500, 1)),
        log_scales=np.full((500, 3), -2, np.float32),
        logit_opacities=np.zeros(500, np.float32),
        sh=np.zeros((500, 1, 3), np.float32),
        codes=np.zeros((500, 3), np.float32),
    )
    head = SemanticHead(np.zeros((2, 3), np.float32), np.zeros(2, np.float32))
    embeddings = np.eye(1, 4, dtype=np.float32)
    scene = Scene(gaussians, head, dictionary_of(["mug"]), embeddings, ("none", "0" * 64), (), "METRIC")
    write_scene(scene, folder / "artefact")
    write_ply(gaussians, folder / "scene.ply")
    import torch

    (folder / "checkpoint").mkdir()
    write_checkpoint(Checkpoint(7, 1.5, {"means": torch.zeros(500, 3)}), folder / "checkpoint", "f")


def _ask_database(data: Path) -> list[Any]:
    with open_service(Settings(data_dir=data)) as service:
        scenes, _ = service.list_scenes()
        jobs, _ = service.list_operations()
        return [scenes, jobs, service.admin.keys.all(), [service.get_scene(scene.id).quality for scene in scenes]]


def _read_scene(folder: Path) -> list[Any]:
    return _values(vars(read_scene(folder).gaussians))


def _read_checkpoint(folder: Path) -> list[Any]:
    checkpoint = read_checkpoint(folder, "f")
    assert checkpoint is not None
    return [checkpoint.iteration, *_values({name: tensor.numpy() for name, tensor in checkpoint.tensors.items()})]


def _values(arrays: dict[str, Any]) -> list[Any]:
    return [(name, array.tobytes()) for name, array in sorted(arrays.items()) if name != "codes"]


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100, int(sys.argv[2]) if len(sys.argv) > 2 else 0)
