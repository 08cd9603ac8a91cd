"""Sentence encoders of the MiniLM family: BERT with mean pooling."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.text.text_tower import TextTower

_MAX_TOKENS = 256


class SentenceEncoder(TextTower):
    """Adapter of MiniLM sentence encoders; one text a run.

    `input_ids`, `attention_mask`, `token_type_ids` int64 [B, T] → `last_hidden_state` [B, T, E], averaged over tokens.
    The int8 weights scale activations by the whole batch, hence single texts.
    """

    def __init__(self, model: Path, tokenizer: Path, *, name: str, threads: int = 0) -> None:
        super().__init__(
            model,
            tokenizer,
            name=name,
            threads=threads,
            max_tokens=_MAX_TOKENS,
            inputs={"input_ids": (None, None), "attention_mask": (None, None)},
            optional_inputs=["token_type_ids"],
            outputs={"last_hidden_state": (None, None, None)},
        )

    def _embedding(self, feed: dict[str, NDArray[np.int64]]) -> NDArray[np.float32]:
        return np.asarray(self._session.run(["last_hidden_state"], feed)[0][0].mean(0))
