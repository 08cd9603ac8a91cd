"""Text encoders: networks, one text a run, several runs in parallel; tables of labels."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tokenizers import Tokenizer

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.perception.models.model_files import only_network, only_table, tokenizer
from fastsplat.service.perception.models.model_manifest import Adapter, find_model, select_adapter
from fastsplat.service.perception.onnx_session import check_contract, file_sha256, open_session
from fastsplat.service.perception.results import TextEncoder
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError


def load_tokenizer(path: Path, *, name: str, max_tokens: int | None = None) -> Tokenizer:
    """Loads an unpadded tokenizer, cut at `max_tokens`; may raise `ModelUnavailableError`."""
    hint = f'Run "fastsplat models pull {name}".'
    if not path.is_file():
        raise ModelUnavailableError(f"model {name}: there is no file {path}", field=name, hint=hint)
    try:
        tokenizer = Tokenizer.from_file(str(path))
    except Exception as error:  # tokenizers raises bare Exception
        raise ModelUnavailableError(f"model {name}: {path.name} is not a tokenizer", field=name, hint=hint) from error
    tokenizer.no_padding()
    if max_tokens is None:
        tokenizer.no_truncation()
    else:
        tokenizer.enable_truncation(max_tokens)
    return tokenizer


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


class LabelTable:
    """An `.npz` with `names` [N] and `embeds` [N, E], looked up by `label_key`.

    Of equal names the first counts. Opening raises `ModelUnavailableError` if the file is missing, damaged, or lacks
    these arrays.
    """

    def __init__(self, table: Path, *, name: str) -> None:
        try:
            with np.load(table, allow_pickle=False) as arrays:
                names, embeds = arrays["names"], np.asarray(arrays["embeds"], np.float32)
            if embeds.ndim != 2 or names.shape != embeds.shape[:1] or not np.isfinite(embeds).all():
                raise ValueError(f"names {names.shape}, embeds {embeds.shape}")
        except Exception as error:  # zipfile, numpy and the check above raise unrelated types
            raise ModelUnavailableError(
                f"model {name}: {table.name} is not a label table with names [N] and finite embeds [N, E] ({error})",
                field=name,
                hint="Restore the table's file.",
            ) from error
        self._embeds = embeds / np.linalg.norm(embeds, axis=1, keepdims=True)
        self._rows: dict[str, int] = {}
        for row, label in enumerate(names):
            self._rows.setdefault(label_key(str(label)), row)
        self.name = name
        self.sha256 = file_sha256(table)

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """float32 [B, E] of unit length; unknown texts raise `InvalidInputError`."""
        self.check_known(texts, "labels")
        rows = [self._rows[label_key(text)] for text in texts]
        return np.asarray(self._embeds[rows], np.float32)

    def check_known(self, texts: Sequence[str], field: str) -> None:
        """Raises `InvalidInputError`, for `field`, that names the texts missing in the table."""
        unknown = [text for text in texts if label_key(text) not in self._rows]
        if unknown:
            raise InvalidInputError(
                f"the label table {self.name} does not know: {', '.join(unknown)}",
                field=field,
                hint="Use other words, or configure a text tower as perception.prompt_encoder.",
            )


def open_text_encoder(name: str, models: Path, *, threads: int = 0) -> TextEncoder:
    """Opens a text encoder by manifest entry or "adapter:folder"; may raise `ModelUnavailableError`.

    `threads` texts are embedded at a time; 0: as many as cores.
    """
    adapter, inside = find_model(name, "text_encoder")
    folder = models / inside
    if adapter == "label_table":
        return LabelTable(only_table(folder, name=name), name=name)
    encoder = select_adapter(TEXT_TOWERS, adapter, name, "text_encoder")
    return encoder(only_network(folder, name=name), tokenizer(folder, name=name), name=name, threads=threads)


TEXT_TOWERS: Mapping[Adapter, type[SentenceEncoder] | type[ClipTextEncoder]] = {
    "sentence": SentenceEncoder,
    "clip": ClipTextEncoder,
}
"""Text encoders that are networks, by the manifest's adapter."""
