"""Characters of names that nobody sees: controls, turns of the direction of writing, letters without width."""

from __future__ import annotations

import unicodedata

from fastsplat_contract.errors import InvalidInputError

_NON_JOINER, _JOINER = "\u200c", "\u200d"
_VIRAMA = 9
_BLANKS = frozenset("\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0")
"""Letters, marks and a symbol by their category, and empty."""


def unseen_in(text: str) -> str:
    """The first character of a name of one line that is not seen, as U+202E; "" for none.

    Joiners pass where a script needs them: after a virama, between Arabic letters, and in emoji of several parts.
    """
    for place, char in enumerate(text):
        category = unicodedata.category(char)
        hidden = category in ("Cc", "Cs", "Zl", "Zp") or char in _BLANKS
        if hidden or (category == "Cf" and not _joins(text[:place], char, text[place + 1 :])):
            return f"U+{ord(char):04X}"
    return ""


def check_seen(name: str, field: str) -> None:
    """Raise `InvalidInputError` about `field` if a name holds a character that is not seen."""
    if unseen := unseen_in(name):
        message = f"the name has the character {unseen}, which nobody sees"
        raise InvalidInputError(message, field=field, hint="Write the name on one line, in plain text.")


def _joins(before: str, joiner: str, after: str) -> bool:
    if joiner not in (_NON_JOINER, _JOINER) or not before:
        return False
    if unicodedata.combining(before[-1]) == _VIRAMA:
        return True
    base = next((char for char in reversed(before) if unicodedata.category(char) != "Mn"), "")
    if not base or not after:
        return False
    if joiner == _JOINER:
        return unicodedata.category(base) in ("So", "Sk") and unicodedata.category(after[0]) == "So"
    return unicodedata.bidirectional(base) == unicodedata.bidirectional(after[0]) == "AL"
