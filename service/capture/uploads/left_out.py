"""Files and frames of an upload that cannot be used: each costs itself, and is named with its reason."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unicodedata import category

from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError

_MAX_LETTERS = 300


class LeftOut:
    """What of one upload is left out. One thread at a time.

    Attributes:
        reasons: by name, as spelled in the upload, a clause for people that does not repeat the name.

    Args:
        strict: nothing may be left out: what would be is raised instead.
    """

    def __init__(self, strict: bool = False) -> None:
        self.reasons: dict[str, str] = {}
        self._strict = strict
        self._first: FastSplatError | None = None

    @contextmanager
    def costs(self, name: str, subject: str = "") -> Iterator[None]:
        """A block in which what is wrong costs one file or frame: its error is noted, and the block ends.

        Args:
            subject: what messages may call it beside its name.
        """
        try:
            yield
        except (InvalidInputError, LimitExceededError) as error:
            if self._strict:
                raise
            self._first = self._first or error
            reason = _clause(error.message, (subject, name))[:_MAX_LETTERS]
            self.reasons.setdefault(_storable(name), _storable(reason))

    def refusal(self, otherwise: FastSplatError) -> FastSplatError:
        """The error of an upload of which too little is left: what was left out first, or `otherwise` for nothing."""
        first, more = self._first, len(self.reasons) - 1
        if first is None or more < 1:
            return first or otherwise
        message = f"{first.message}; {more} other{'s' if more > 1 else ''} of the upload cannot be used either"
        return type(first)(message, hint=first.hint, field=first.field, limit=first.limit)


def _clause(message: str, names: tuple[str, ...]) -> str:
    """A message without the name that stands before it in a list."""
    for name in filter(None, names):
        for separator, begin in ((" ", "it "), (": ", "")):
            if message.startswith(name + separator):
                return begin + message[len(name) + len(separator) :]
    return message


def _storable(text: str) -> str:
    """Without control characters and lone surrogates: documents of strangers name files by any text."""
    return "".join("\N{REPLACEMENT CHARACTER}" if category(letter) in ("Cc", "Cs") else letter for letter in text)
