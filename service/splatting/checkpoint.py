"""The state of a run on disk: one safetensors file, written beside, flushed, renamed."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path

import safetensors
import safetensors.torch
from torch import Tensor

from fastsplat_contract.errors import ConflictError

_NAME = "training.safetensors"
_VERSION = 1


@dataclass(frozen=True)
class Checkpoint:
    """Everything the next iteration depends on; random numbers are drawn afresh from (seed, iteration).

    Attributes:
        iteration: completed optimisation steps.
        elapsed_s: seconds of optimisation behind them.
        tensors: parameters and optimizer moments by name.
    """

    iteration: int
    elapsed_s: float
    tensors: dict[str, Tensor]


def write_checkpoint(checkpoint: Checkpoint, folder: Path, fingerprint: str) -> None:
    """Replaces the checkpoint in `folder`; a crash at any moment leaves the old one or the new one, whole."""
    folder.mkdir(parents=True, exist_ok=True)
    metadata = {
        "version": str(_VERSION),
        "fingerprint": fingerprint,
        "iteration": str(checkpoint.iteration),
        "elapsed_s": checkpoint.elapsed_s.hex(),
    }
    content = safetensors.torch.save({name: t.contiguous() for name, t in checkpoint.tensors.items()}, metadata)
    beside = folder / f".{_NAME}.{os.getpid()}"
    try:
        with beside.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(folder / _NAME)
    finally:
        beside.unlink(missing_ok=True)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read_checkpoint(folder: Path, fingerprint: str) -> Checkpoint | None:
    """The checkpoint in `folder`, or None when there is none.

    Raises:
        ConflictError: the file belongs to a run with other settings or inputs, or cannot be read.
    """
    path = folder / _NAME
    if not path.exists():
        return None
    hint = "Remove the checkpoint to start afresh."
    try:
        with safetensors.safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    except (safetensors.SafetensorError, OSError) as error:
        raise ConflictError(f"the checkpoint cannot be read: {error}", field=_NAME, hint=hint) from error
    if metadata.get("version") != str(_VERSION) or metadata.get("fingerprint") != fingerprint:
        raise ConflictError("the checkpoint belongs to another training run", field=_NAME, hint=hint)
    return Checkpoint(int(metadata["iteration"]), float.fromhex(metadata["elapsed_s"]), tensors)


def fingerprint_of(settings: dict[str, object], names: tuple[str, ...], labels: tuple[str, ...], points: bytes) -> str:
    """Hex digest of what must agree between a run and its continuation."""
    text = json.dumps([settings, names, labels], sort_keys=True)
    return hashlib.sha256(text.encode() + points).hexdigest()
