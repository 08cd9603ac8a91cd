"""Which dictionary entry each Gaussian's code stands for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.types import F32, SemanticHead

_CHUNK_LOGITS = 4 << 20


def most_probable_class(codes: F32, head: SemanticHead) -> NDArray[np.int32]:
    """int32 [G]: argmax over softmax(W·code + b) of each Gaussian, 0 = undetected; ties go to the lower id."""
    return codes_field(codes, head)[0]


def codes_field(codes: F32, head: SemanticHead) -> tuple[NDArray[np.int32], F32]:
    """int32 [G] argmax and float32 [G] maximum over softmax(W·code + b) of each Gaussian; ties go to the lower id.

    With a single class (a scene without labels) nothing was ever asked of the codes, and the confidence is 0. Works
    through bounded pieces: a million Gaussians and a thousand labels need 16 MiB beside the result.
    """
    classes = len(head.bias)
    labels = np.zeros(len(codes), dtype=np.int32)
    confidence = np.zeros(len(codes), dtype=np.float32)
    if classes == 1:
        return labels, confidence
    rows = max(1, _CHUNK_LOGITS // classes)
    for start in range(0, len(codes), rows):
        piece = slice(start, start + rows)
        logits = codes[piece] @ head.weight.T
        logits += head.bias
        labels[piece] = logits.argmax(axis=1)
        logits -= logits.max(axis=1, keepdims=True)
        confidence[piece] = 1 / np.exp(logits, out=logits).sum(axis=1)
    return labels, confidence
