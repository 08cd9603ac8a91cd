"""Parses questions about time: "what moved since Monday?", "where was the mug on 23 November?"."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from typing import Literal

from fastsplat_contract.photos.localization import ChangeKind

_DAYS = ("monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday")
_MONTHS = (
    *("january", "february", "march", "april", "may", "june", "july", "august", "september", "october", "november"),
    "december",
)
_EVENTS: dict[str, frozenset[ChangeKind]] = {
    **dict.fromkeys(("moved",), frozenset[ChangeKind](("moved",))),
    **dict.fromkeys(
        ("gone", "missing", "lost", "disappeared", "vanished", "removed", "taken away"),
        frozenset[ChangeKind](("gone", "changed")),
    ),
    **dict.fromkeys(("new", "added", "appeared"), frozenset[ChangeKind](("new",))),
    **dict.fromkeys(("changed", "different"), frozenset[ChangeKind](("gone", "moved", "new", "changed"))),
}
"""Events that a word asks for; an object replaced by something else is gone."""
_ANYTHING = "|".join(sorted(_EVENTS, key=len, reverse=True))
_WHAT = re.compile(
    rf"(?:what|what else|which (?:thing|object)s?|(?:is|has|have|did|was|are) (?:anything|something))"
    rf"(?: has| have| is| are| was)?(?: been| got)? (?P<event>{_ANYTHING}|move|change)"
    r"(?: (?:here|in (?:the|this) \w+))?(?: since (?P<when>.+))?"
)
_WHERE = re.compile(r"where (?:was|were) (?P<rest>.+)")
_MOST_WORDS = 4
"""Most words of a date with its preposition."""
_LAST = (
    re.compile(r"when (?:was|were) (?P<about>.+?) (?:last )?seen(?: last)?"),
    re.compile(r"when did (?:you|we|i|anyone|anybody|somebody) (?:last )?see (?P<about>.+?)(?: last)?"),
    re.compile(r"since when (?:is|are|has|have) (?P<about>.+?) (?:been )?(?:missing|gone)"),
    re.compile(r"(?:is|are|has|have) (?P<about>.+?) (?:been )?(?:moved|gone|missing|still (?:there|here))"),
)


@dataclass(frozen=True)
class When:
    """A period of one or more days, UTC."""

    start: datetime
    end: datetime  # exclusive


@dataclass(frozen=True)
class TimeQuestion:
    """A parsed question about time."""

    asks: Literal["events", "place", "last_seen"]  # changes of all objects; past places; last sightings
    about: str = ""  # the words for those objects; "" for events
    events: frozenset[ChangeKind] = frozenset()  # those that are asked for
    when: When | None = None  # the day that is asked about, or since which; None for none


def time_question(text: str, now: datetime) -> TimeQuestion | None:
    """Parses a question about time, weekdays before `now`, days in UTC; else None."""
    words = " ".join(text.casefold().strip().rstrip("?!. ").split())
    if match := _WHAT.fullmatch(words):
        when = parsed_day(match["when"], now) if match["when"] else None
        if match["when"] and when is None:
            return None
        event = {"move": "moved", "change": "changed"}.get(match["event"], match["event"])
        return TimeQuestion("events", events=_EVENTS[event], when=when)
    if match := _WHERE.fullmatch(words):
        rest = match["rest"].split()
        for count in range(min(_MOST_WORDS, len(rest) - 1), 0, -1):
            if (when := parsed_day(" ".join(rest[-count:]), now)) is not None:
                return TimeQuestion("place", " ".join(rest[:-count]), when=when)
    for pattern in _LAST:
        if match := pattern.fullmatch(words):
            return TimeQuestion("last_seen", match["about"])
    return None


def parsed_day(words: str, now: datetime) -> When | None:
    """Parses words for a past day or period; None if they are none.

    Such as "monday", "last monday", "yesterday", "3 days ago", "last week", "2026-11-23", "23 november 2026"."""
    today = now.astimezone(UTC).date()
    words = re.sub(r"^(?:on|in|the) ", "", words).replace(",", "")
    plain = {"today": 0, "yesterday": 1}
    if words in plain:
        return _days(today - timedelta(plain[words]))
    if words == "last week":
        monday = today - timedelta(today.weekday() + 7)
        return _days(monday, 7)
    if (named := words.removeprefix("last ")) in _DAYS:
        back = (today.weekday() - _DAYS.index(named)) % 7
        return _days(today - timedelta(back or (7 if words != named else 0)))
    if ago := re.fullmatch(r"(\d{1,4}|a|one) (day|week)s? ago", words):
        count = int(ago[1]) if ago[1].isdigit() else 1
        return _days(today - timedelta(count * (7 if ago[2] == "week" else 1)))
    try:
        if re.fullmatch(r"\d{4}-\d\d-\d\d", words):
            return _days(date.fromisoformat(words))
        if spelt := re.fullmatch(r"(\d{1,2})(?:st|nd|rd|th)? ([a-z]+)(?: (\d{4}))?", words):
            return _spelt(int(spelt[1]), spelt[2], spelt[3], today)
        if spelt := re.fullmatch(r"([a-z]+) (\d{1,2})(?:st|nd|rd|th)?(?: (\d{4}))?", words):
            return _spelt(int(spelt[2]), spelt[1], spelt[3], today)
    except ValueError:  # the thirtieth of February
        return None
    return None


def _spelt(day: int, month: str, year: str | None, today: date) -> When | None:
    known = [number for number, name in enumerate(_MONTHS, start=1) if month in (name, name[:3])]
    if not known:
        return None
    if year is not None:
        return _days(date(int(year), known[0], day))
    meant = date(today.year, known[0], day)
    return _days(meant if meant <= today else date(today.year - 1, known[0], day))


def _days(first: date, count: int = 1) -> When:
    start = datetime.combine(first, time(), UTC)
    return When(start, start + timedelta(count))
