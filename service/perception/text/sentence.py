"""Sentence encoders of the MiniLM family: a BERT and a masked mean."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.onnx_session import check_contract, file_sha256, open_session
from fastsplat.service.perception.text.runs import embed_side_by_side
from fastsplat.service.perception.text.tokens import load_tokenizer

_MAX_TOKENS = 256


class SentenceEncoder:
    """`input_ids`, `attention_mask`, `token_type_ids` int64 [B, T] → `last_hidden_state` [B, T, E]; mean over tokens,
    then unit length.

    One text a run: the int8 weights scale activations by the whole batch, so that a text's embedding would
    otherwise depend on its neighbors.

    Raises:
        ModelUnavailableError: on opening, when a file is missing or does not keep this contract.
    """

    def __init__(self, model: Path, tokenizer: Path, *, name: str, threads: int = 0) -> None:
        self._tokenizer = load_tokenizer(tokenizer, name=name, max_tokens=_MAX_TOKENS)
        self._session = open_session(model, name=name, threads=1)
        self._threads = threads
        check_contract(
            self._session,
            name=name,
            inputs={"input_ids": (None, None), "attention_mask": (None, None)},
            optional_inputs=["token_type_ids"],
            outputs={"last_hidden_state": (None, None, None)},
        )
        self._inputs = {node.name for node in self._session.get_inputs()}
        self.name = name
        self.sha256 = file_sha256(model)

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """float32 [B, E] of unit length; texts are cut at 256 tokens."""
        return embed_side_by_side(self._encode, texts, self._threads)

    def _encode(self, text: str) -> NDArray[np.float32]:
        encoding = self._tokenizer.encode(text)
        ids = np.asarray([encoding.ids], np.int64)
        feed = {"input_ids": ids, "attention_mask": np.ones_like(ids), "token_type_ids": np.zeros_like(ids)}
        feed = {key: value for key, value in feed.items() if key in self._inputs}
        hidden = self._session.run(["last_hidden_state"], feed)[0][0]
        mean = hidden.mean(0)
        return np.asarray(mean / np.linalg.norm(mean), np.float32)
