"""Records unusable files and frames of an upload with reasons."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unicodedata import category

from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError

_MAX_LETTERS = 300


class LeftOut:
    """Records an upload's unusable files, in one thread; if `strict`, raises their errors."""

    def __init__(self, strict: bool = False) -> None:
        self.reasons: dict[str, str] = {}  # by name in the upload, clauses without the name
        self._strict = strict
        self._first: FastSplatError | None = None

    @contextmanager
    def costs(self, name: str, subject: str = "") -> Iterator[None]:
        """Makes a block whose error costs one file, called `name` or `subject` in messages."""
        try:
            yield
        except (InvalidInputError, LimitExceededError) as error:
            if self._strict:
                raise
            self._first = self._first or error
            reason = _clause(error.message, (subject, name))[:_MAX_LETTERS]
            self.reasons.setdefault(_storable(name), _storable(reason))

    def refusal(self, otherwise: FastSplatError) -> FastSplatError:
        """Makes the error of an upload with too little left: the first, or `otherwise`."""
        first, more = self._first, len(self.reasons) - 1
        if first is None or more < 1:
            return first or otherwise
        message = f"{first.message}; {more} other{'s' if more > 1 else ''} of the upload cannot be used either"
        return type(first)(message, hint=first.hint, field=first.field, limit=first.limit)


def _clause(message: str, names: tuple[str, ...]) -> str:
    """Strips a leading name from a message."""
    for name in filter(None, names):
        for separator, begin in ((" ", "it "), (": ", "")):
            if message.startswith(name + separator):
                return begin + message[len(name) + len(separator) :]
    return message


def _storable(text: str) -> str:
    """Replaces control characters and lone surrogates, which untrusted documents may contain."""
    return "".join("\N{REPLACEMENT CHARACTER}" if category(letter) in ("Cc", "Cs") else letter for letter in text)
