"""CLIP text towers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.text.text_tower import TextTower

_CONTEXT = 77


class ClipTextEncoder(TextTower):
    """Adapter of CLIP text towers; one unpadded text a run.

    `input_ids` int64 [B, T] (and `attention_mask`, if the export kept it) → `text_embeds` [B, E]. The tower reads its
    embedding at the first end-of-text token, which CLIP also pads with.
    """

    def __init__(self, model: Path, tokenizer: Path, *, name: str, threads: int = 0) -> None:
        super().__init__(
            model,
            tokenizer,
            name=name,
            threads=threads,
            max_tokens=_CONTEXT,
            inputs={"input_ids": (None, None)},
            optional_inputs=["attention_mask"],
            outputs={"text_embeds": (None, None)},
        )

    def _embedding(self, feed: dict[str, NDArray[np.int64]]) -> NDArray[np.float32]:
        return np.asarray(self._session.run(["text_embeds"], feed)[0][0])
