"""Label embeddings from a table instead of a text tower."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.perception.onnx_session import file_sha256
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError


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
