"""A checkpoint with a flipped bit is refused, wherever the bit is; whole, it comes back as it was."""

from __future__ import annotations

import random
from contextlib import suppress
from pathlib import Path

import torch

from fastsplat.service.splatting.training.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from fastsplat_contract.errors import ConflictError


def test_a_flipped_bit_is_never_trained_on(tmp_path: Path) -> None:
    tensors = {"means": torch.arange(30.0).reshape(10, 3), "ids": torch.arange(4), "none": torch.zeros(0, 2)}
    for iteration in (6, 7):
        write_checkpoint(Checkpoint(iteration, 1.5, tensors), tmp_path, "fingerprint")
    assert read_checkpoint(tmp_path / "none", "fingerprint") is None
    back = read_checkpoint(tmp_path, "fingerprint")
    assert back is not None and (back.iteration, back.elapsed_s) == (7, 1.5)
    assert all(torch.equal(back.tensors[name], tensors[name]) for name in tensors)
    (path,) = tmp_path.iterdir()
    whole, rng = path.read_bytes(), random.Random(0)
    harmless = 0
    for _ in range(100):
        data = bytearray(whole)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        with suppress(ConflictError):
            read = read_checkpoint(tmp_path, "fingerprint")
            # None is an older format, by its number; else the bit stood where nothing is written.
            assert read is None or (read.iteration, read.elapsed_s) == (7, 1.5)
            assert read is None or all(torch.equal(read.tensors[name], tensors[name]) for name in tensors)
            harmless += 1
    assert harmless < 5
