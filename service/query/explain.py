"""One sentence that says why."""

from __future__ import annotations

from collections.abc import Sequence

from service.query.types import Match, Verdict

_SHOWN = 3
_MAX_QUOTED = 60


def explain(text: str, verdict: Verdict, matches: Sequence[Match], named: bool, calibrated: bool) -> str:
    """Why the answer is what it is, for people.

    Args:
        text: the query.
        verdict: of the answer.
        matches: of the answer, best first.
        named: whether the hash table knew the query's name.
        calibrated: whether there were thresholds to hold the scores against.
    """
    asked = text if len(text) <= _MAX_QUOTED else text[: _MAX_QUOTED - 1] + "…"
    if not matches:
        return f'No "{asked}" here: this scene has no labels.'
    chosen = [match for match in matches if match.relevant]
    shown = ", then ".join(f'"{match.label}"' for match in chosen[:_SHOWN])
    more = f" and {len(chosen) - _SHOWN} more" if len(chosen) > _SHOWN else ""
    best = matches[0]
    if verdict == "exact":
        how = f'The scene has "{best.label}"' if named else f'"{asked}" goes by {shown}{more} here'
        missing = "" if best.gaussian_count else ", but no Gaussian of it remains"
        return f"{how}{missing}."
    if verdict == "related":
        return f'No "{asked}" here; the closest is {shown}{more} (similarity {best.similarity:.2f}).'
    if not calibrated:
        return (
            f'No entry is named "{asked}". This text encoder is not calibrated, so only names count; '
            f'the nearest entry is "{best.label}" (similarity {best.similarity:.2f}).'
        )
    return f'Nothing like "{asked}" is here; even "{best.label}" is far (similarity {best.similarity:.2f}).'
