"""The state of a run on disk: one safetensors file, written beside, flushed, renamed."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.common.files import atomic_file
from fastsplat.service.splatting.training_views import TrainingView
from fastsplat_contract.errors import ConflictError

_NAME = "training.safetensors"
_VERSION = 2
"""Of the format, and of what a training does; a change of either counts on."""


_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Checkpoint:
    """Everything the next iteration depends on; random numbers are drawn afresh from (seed, iteration).

    Attributes:
        iteration: completed optimization steps.
        elapsed_s: seconds of optimization behind them.
        tensors: parameters, moments and label maps by name.
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
    metadata["sha256"] = _seal(metadata, checkpoint.tensors)
    content = safetensors.torch.save({name: t.contiguous() for name, t in checkpoint.tensors.items()}, metadata)
    with atomic_file(folder / _NAME) as beside:
        beside.write_bytes(content)


def read_checkpoint(folder: Path, fingerprint: str) -> Checkpoint | None:
    """The checkpoint in `folder`, or None when there is none, or one of an older format only, which the log then says.

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
    version = metadata.get("version", "")
    if version.isdecimal() and int(version) < _VERSION:
        _log.warning("%s has format %s and is not continued: training starts anew", path, version)
        return None
    if version != str(_VERSION) or metadata.get("fingerprint") != fingerprint:
        raise ConflictError("the checkpoint belongs to another training run", field=_NAME, hint=hint)
    seal = metadata.pop("sha256", "")
    if seal != _seal(metadata, tensors):
        raise ConflictError("the checkpoint does not match its own digest", field=_NAME, hint=hint)
    try:
        return Checkpoint(int(metadata["iteration"]), float.fromhex(metadata["elapsed_s"]), tensors)
    except (KeyError, ValueError) as error:
        raise ConflictError("the checkpoint is damaged", field=_NAME, hint=hint) from error


def _seal(metadata: Mapping[str, str], tensors: Mapping[str, Tensor]) -> str:
    """sha256 of everything in a checkpoint: a flipped bit must not be trained on."""
    digest = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    for name in sorted(tensors):
        digest.update(name.encode())
        _update(digest, tensors[name].contiguous().cpu().numpy())
    return digest.hexdigest()


def fingerprint_of(
    settings: Mapping[str, Any], labels: Sequence[str], views: Sequence[TrainingView], arrays: Iterable[NDArray[Any]]
) -> str:
    """Hex digest of what must agree between a run and its continuation.

    Args:
        settings: of the run, JSON-ready, and whatever else changes it.
        views: all that are loaded: their names, cameras, poses, images, masks and label maps enter at training size.
    """
    head = [settings, list(labels), [(view.name, view.exposure_ev, asdict(view.frames[-1].camera)) for view in views]]
    digest = hashlib.sha256(json.dumps(head, sort_keys=True).encode())
    for view in views:
        frame = view.frames[-1]
        for tensor in (view.viewmat, frame.rgb, frame.valid, frame.labels, frame.depth):
            _update(digest, None if tensor is None else tensor.cpu().numpy())
    for array in arrays:
        _update(digest, array)
    return digest.hexdigest()


def _update(digest: Any, array: NDArray[Any] | None) -> None:
    """Adds type, shape and bytes, so that no two sequences of arrays look alike."""
    if array is None:
        digest.update(b"none;")
        return
    digest.update(f"{array.dtype.str}{array.shape};".encode())
    digest.update(np.ascontiguousarray(array).data)
