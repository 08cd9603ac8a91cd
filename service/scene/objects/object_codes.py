"""Maps classes of the objects' semantic codes to the current objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.scene import F32, SemanticHead

_CHUNK_LOGITS = 4 << 20
_CANDIDATES = 1_024  # random directions from which a new class takes the most distant
_SEED = 11


@dataclass(frozen=True)
class ObjectCodes:
    """Codes that classify composited pixels by object."""

    codes: F32  # [G, D]
    head: SemanticHead  # C classes; class 0 is no object
    ids: NDArray[np.int32]  # [C]: object id of each class, 0 for none


def codes_of_objects(codes: F32, head: SemanticHead, owner: NDArray[np.int32]) -> ObjectCodes:
    """Assigns each class to an object, and adds classes for new objects.

    A class stands for the object that owns most of its Gaussians, so merging and discarding change no code. Objects
    without a class, because they were cut out, added or copied since, get a new one far from the others (random
    search), and their Gaussians its code.

    Args:
        codes: float32 [G, D], D ≥ 1.
        head: [C, D], trained with the codes.
        owner: int32 [G], current object id of each Gaussian, 0 for none.
    """
    classes, _ = classes_of_codes(codes, head)
    ids = np.zeros(len(head.bias), np.int32)
    coded = codes.any(axis=1)  # Gaussians from other scenes have no code
    pairs, counts = np.unique((classes.astype(np.int64) << 16 | owner)[coded], return_counts=True)
    pairs = pairs[np.argsort(counts, kind="stable")]  # the largest count is written last and wins
    ids[pairs >> 16] = pairs & 0xFFFF
    ids[0] = 0
    new = np.setdiff1d(owner, np.append(ids, 0))
    if not len(new):
        return ObjectCodes(codes, head, ids)
    directions, norms = _separate_directions(head.weight, len(new)), np.linalg.norm(codes, axis=1)
    strength = float(np.median(np.linalg.norm(head.weight, axis=1)))
    length = float(np.median(norms[norms > 0])) if (norms > 0).any() else 1.0
    codes = np.array(codes)
    for object_id, direction in zip(new.tolist(), directions, strict=True):
        codes[owner == object_id] = length * direction
    weight = np.concatenate([head.weight, strength * directions]).astype(np.float32)
    bias = np.concatenate([head.bias, np.full(len(new), np.median(head.bias))]).astype(np.float32)
    return ObjectCodes(codes, SemanticHead(weight, bias), np.concatenate([ids, new]).astype(np.int32))


def classes_of_codes(codes: F32, head: SemanticHead) -> tuple[NDArray[np.int32], F32]:
    """Returns the class of each code [G, D], ties to the lower, and its probability.

    Works in bounded chunks: a million Gaussians and a thousand classes need 16 MiB beside the result. With a single
    class (a scene without labels) the probability is 0.
    """
    classes = np.zeros(len(codes), dtype=np.int32)
    confidence = np.zeros(len(codes), dtype=np.float32)
    class_count = len(head.bias)
    if class_count == 1:
        return classes, confidence
    rows = max(1, _CHUNK_LOGITS // class_count)
    for start in range(0, len(codes), rows):
        piece = slice(start, start + rows)
        logits = codes[piece] @ head.weight.T
        logits += head.bias
        classes[piece] = logits.argmax(axis=1)
        logits -= logits.max(axis=1, keepdims=True)
        confidence[piece] = 1 / np.exp(logits, out=logits).sum(axis=1)
    return classes, confidence


def _separate_directions(weight: F32, count: int) -> F32:
    """Picks unit vectors, float32 [count, D], greedily far from the rows of `weight` and each other."""
    rng = np.random.default_rng(_SEED)
    candidates = rng.normal(size=(_CANDIDATES, weight.shape[1]))
    candidates /= np.linalg.norm(candidates, axis=1, keepdims=True)
    lengths = np.linalg.norm(weight, axis=1, keepdims=True)
    nearest = (candidates @ (weight / np.maximum(lengths, 1e-12)).T).max(axis=1)
    chosen = []
    for _ in range(count):
        best = int(nearest.argmin())
        chosen.append(candidates[best])
        nearest = np.maximum(nearest, candidates @ candidates[best])
    return np.stack(chosen).astype(np.float32)
