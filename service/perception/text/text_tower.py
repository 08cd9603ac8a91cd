"""Text embedding networks, one text a run, several runs in parallel."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.onnx_session import check_contract, file_sha256, open_session
from fastsplat.service.perception.text.tokens import load_tokenizer

_MAX_TOKENS = 256

_CONTEXT = 77


def embed_side_by_side(
    run: Callable[[str], NDArray[np.float32]], texts: Sequence[str], threads: int
) -> NDArray[np.float32]:
    """Embeds at least one text in parallel, one a run, in order, float32 [B, E].

    Sentences are short, so that a second thread inside a run gains nothing. `threads` 0: all cores.
    """
    side_by_side = min(threads or os.cpu_count() or 1, len(texts))
    if side_by_side == 1:
        return np.stack([run(text) for text in texts])
    # New threads inherit the caller's priority, which kept ones would not.
    with ThreadPoolExecutor(side_by_side, thread_name_prefix="text-encoder") as pool:
        return np.stack(list(pool.map(run, texts)))


class TextTower(ABC):
    """A text encoder that cuts texts at `max_tokens`.

    Opening raises `ModelUnavailableError` if a file is missing or breaks the contract.
    """

    def __init__(
        self, model: Path, tokenizer: Path, *, name: str, threads: int, max_tokens: int, **contract: Any
    ) -> None:
        self._tokenizer = load_tokenizer(tokenizer, name=name, max_tokens=max_tokens)
        self._session = open_session(model, name=name, threads=1)
        self._threads = threads
        check_contract(self._session, name=name, **contract)
        self._inputs = {node.name for node in self._session.get_inputs()}
        self.name = name
        self.sha256 = file_sha256(model)

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """float32 [B, E] of unit length."""
        return embed_side_by_side(self._encode, texts, self._threads)

    def _encode(self, text: str) -> NDArray[np.float32]:
        ids = np.asarray([self._tokenizer.encode(text).ids], np.int64)
        feed = {"input_ids": ids, "attention_mask": np.ones_like(ids), "token_type_ids": np.zeros_like(ids)}
        embedding = self._embedding({key: value for key, value in feed.items() if key in self._inputs})
        return np.asarray(embedding / np.linalg.norm(embedding), np.float32)

    @abstractmethod
    def _embedding(self, feed: dict[str, NDArray[np.int64]]) -> NDArray[np.float32]:
        """[E] of one text."""


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
