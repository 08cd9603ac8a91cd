"""CLIP text towers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.onnx_session import check_contract, file_sha256, open_session
from fastsplat.service.perception.text.runs import embed_side_by_side
from fastsplat.service.perception.text.tokens import load_tokenizer

_CONTEXT = 77


class ClipTextEncoder:
    """`input_ids` int64 [B, T] (and `attention_mask`, where the export kept it) → `text_embeds` [B, E]; unit length.

    One text a run, unpadded: the tower reads its embedding at the first end-of-text token, which CLIP also pads with.

    Raises:
        ModelUnavailableError: on opening, when a file is missing or does not keep this contract.
    """

    def __init__(self, model: Path, tokenizer: Path, *, name: str, threads: int = 0) -> None:
        self._tokenizer = load_tokenizer(tokenizer, name=name, max_tokens=_CONTEXT)
        self._session = open_session(model, name=name, threads=1)
        self._threads = threads
        check_contract(
            self._session,
            name=name,
            inputs={"input_ids": (None, None)},
            optional_inputs=["attention_mask"],
            outputs={"text_embeds": (None, None)},
        )
        self._masked = len(self._session.get_inputs()) == 2
        self.name = name
        self.sha256 = file_sha256(model)

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """float32 [B, E] of unit length; texts are cut at 77 tokens."""
        return embed_side_by_side(self._encode, texts, self._threads)

    def _encode(self, text: str) -> NDArray[np.float32]:
        ids = np.asarray([self._tokenizer.encode(text).ids], np.int64)
        feed = {"input_ids": ids} | ({"attention_mask": np.ones_like(ids)} if self._masked else {})
        embedding = self._session.run(["text_embeds"], feed)[0][0]
        return np.asarray(embedding / np.linalg.norm(embedding), np.float32)
