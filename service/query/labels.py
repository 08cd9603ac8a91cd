"""Which dictionary entry each Gaussian is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.scene.types import F32, SemanticHead

_CHUNK_LOGITS = 4 << 20


def most_probable_class(codes: F32, head: SemanticHead) -> NDArray[np.int32]:
    """int32 [G]: argmax over softmax(W·code + b) of each Gaussian, 0 = undetected; ties go to the lower id.

    The softmax keeps the order of the logits, so it is never computed. Works through bounded pieces: a million
    Gaussians and a thousand labels need 16 MiB beside the result.
    """
    classes = len(head.bias)
    labels = np.zeros(len(codes), dtype=np.int32)
    rows = max(1, _CHUNK_LOGITS // classes)
    for start in range(0, len(codes), rows):
        piece = slice(start, start + rows)
        logits = codes[piece] @ head.weight.T
        logits += head.bias
        labels[piece] = logits.argmax(axis=1)
    return labels
