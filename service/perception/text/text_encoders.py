"""Text encoders: networks, one text a run, several runs in parallel; tables of labels."""

from __future__ import annotations

import json
import os
import string
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from tokenizers import Tokenizer

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.perception.models.model_files import only_table, text_network, tokenizer
from fastsplat.service.perception.models.model_manifest import Adapter, find_model, select_adapter
from fastsplat.service.perception.onnx_session import Contract, file_sha256, find_contract, open_session
from fastsplat.service.perception.results import TextEncoder
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError

_CONTEXTS = {"MiniLM": (256, False), "CLIP": (77, False), "SigLIP": (64, True), "open_clip": (77, True)}
"""Most tokens of a text, and whether all texts are padded to them, where a network's input leaves that open."""
_TOKENS = (1, None)
_NO_PUNCTUATION = str.maketrans("", "", string.punctuation)


def load_tokenizer(path: Path, *, name: str, max_tokens: int | None = None, padded: bool = False) -> Tokenizer:
    """Loads a tokenizer that cuts texts at `max_tokens`; may raise `ModelUnavailableError`.

    If `padded`, it pads them to that number with the token of `tokenizer_config.json` beside it."""
    hint = f'Run "fastsplat models pull {name}".'
    if not path.is_file():
        raise ModelUnavailableError(f"model {name}: there is no file {path}", field=name, hint=hint)
    try:
        tokenizer = Tokenizer.from_file(str(path))
    except Exception as error:  # tokenizers raises bare Exception
        raise ModelUnavailableError(f"model {name}: {path.name} is not a tokenizer", field=name, hint=hint) from error
    tokenizer.no_padding()
    tokenizer.no_truncation()
    if max_tokens is not None:
        tokenizer.enable_truncation(max_tokens)
    if padded:
        config = path.with_name("tokenizer_config.json")
        try:
            token = json.loads(config.read_text("utf-8"))["pad_token"]
            token = token["content"] if isinstance(token, dict) else token
            tokenizer.enable_padding(length=max_tokens, pad_token=token, pad_id=tokenizer.token_to_id(token))
        except (OSError, ValueError, KeyError, TypeError) as error:
            wrong = f"model {name}: {config.name} names no padding token that {path.name} knows"
            raise ModelUnavailableError(wrong, field=name, hint="Put it beside the tokenizer.") from error
    return tokenizer


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


class TextTower:
    """A text encoder of tokens, one text a run.

    Opening raises `ModelUnavailableError` if a file is missing or breaks all of `contracts`.
    """

    contracts: ClassVar[Mapping[str, Contract]]

    def __init__(self, model: Path, tokenizer: Path, *, name: str, threads: int = 0) -> None:
        self._session = open_session(model, name=name, threads=1)
        self._threads = threads
        optional = ("attention_mask", "token_type_ids")
        self.contract = find_contract(self._session, self.contracts, name=name, optional_inputs=optional)
        (self._ids, *_), (self._output, *_) = self.contracts[self.contract]
        self._nodes = {node.name: node for node in self._session.get_inputs()}
        length = self._nodes[self._ids].shape[1]
        self._context, padded = _CONTEXTS[self.contract]
        if isinstance(length, int) and self.contract != "MiniLM":  # whose mean knows no padding
            self._context, padded = length, True
        self._tokenizer = load_tokenizer(tokenizer, name=name, max_tokens=self._context, padded=padded)
        self.name = name
        self.sha256 = file_sha256(model)

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """float32 [B, E] of unit length."""
        return embed_side_by_side(self._encode, texts, self._threads)

    def _encode(self, text: str) -> NDArray[np.float32]:
        kind = np.int32 if self._nodes[self._ids].type == "tensor(int32)" else np.int64
        ids = np.asarray([self._tokenizer.encode(text).ids], kind)
        feed = {self._ids: ids, "attention_mask": np.ones_like(ids), "token_type_ids": np.zeros_like(ids)}
        output = self._session.run([self._output], {key: feed[key] for key in self._nodes})[0][0]
        embedding = output.mean(0) if output.ndim == 2 else output
        return np.asarray(embedding / np.linalg.norm(embedding), np.float32)


class SentenceEncoder(TextTower):
    """Adapter of MiniLM sentence encoders.

    `input_ids`, `attention_mask`, `token_type_ids` int64 [B, T] → `last_hidden_state` [B, T, E], averaged over tokens.
    The int8 weights scale activations by the whole batch, hence single texts.
    """

    contracts: ClassVar = {
        "MiniLM": ({"input_ids": _TOKENS, "attention_mask": _TOKENS}, {"last_hidden_state": (1, None, None)})
    }


class ClipTextEncoder(TextTower):
    """Adapter of text towers of image-text models; inputs and outputs tell which.

    - CLIP: `input_ids` [B, T] → `text_embeds` [B, E], read at the first end-of-text token: texts need no padding.
    - SigLIP: `input_ids` [B, 64] → `pooler_output` [B, E], with padding, as it was trained (Zhai et al. 2023).
    - open_clip as Immich exports it: `text` [1, T] → `embedding` [1, E], with padding.
    """

    contracts: ClassVar = {
        "CLIP": ({"input_ids": _TOKENS}, {"text_embeds": (1, None)}),
        "SigLIP": ({"input_ids": _TOKENS}, {"pooler_output": (1, None)}),
        "open_clip": ({"text": _TOKENS}, {"embedding": (1, None)}),
    }

    def _encode(self, text: str) -> NDArray[np.float32]:
        if self._context == _CONTEXTS["SigLIP"][0]:  # in open_clip's configurations too, where CLIP has 77
            text = " ".join(text.replace("_", " ").translate(_NO_PUNCTUATION).lower().split())
        return super()._encode(text)


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

    def knows(self, text: str) -> bool:
        """True if the table has an embedding of a text."""
        return label_key(text) in self._rows

    def check_known(self, texts: Sequence[str], field: str) -> None:
        """Raises `InvalidInputError`, for `field`, that names the texts missing in the table."""
        if unknown := [text for text in texts if not self.knows(text)]:
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
    network = text_network(folder, name=name)
    return encoder(network, tokenizer(network.parent, name=name), name=name, threads=threads)


TEXT_TOWERS: Mapping[Adapter, type[SentenceEncoder] | type[ClipTextEncoder]] = {
    "sentence": SentenceEncoder,
    "clip": ClipTextEncoder,
}
"""Text encoders that are networks, by the manifest's adapter."""
