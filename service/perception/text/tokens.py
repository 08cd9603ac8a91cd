"""Tokenizers from a `tokenizer.json`."""

from __future__ import annotations

from pathlib import Path

from tokenizers import Tokenizer

from fastsplat_contract.errors import ModelUnavailableError


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
