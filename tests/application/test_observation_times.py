"""When the photos of an observation were taken: as is said, as their metadata say, or when they came."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

from fastsplat.service.application.editing.observing import _time_of

_NOW = datetime(2026, 11, 26, 9, tzinfo=UTC)
_DAY = timedelta(days=1)


def test_what_is_said_counts_before_metadata_and_these_before_the_time_of_coming() -> None:
    taken = [(_NOW - days * _DAY).timestamp() for days in (3, 2)]
    said = datetime(2026, 11, 20, 10, tzinfo=timezone(timedelta(hours=1)))
    assert _time_of(said, taken, _NOW) == (said, "given")
    assert _time_of(None, taken, _NOW) == (_NOW - 2 * _DAY, "metadata")
    assert _time_of(None, [], _NOW) == (_NOW, "received")


def test_a_camera_whose_clock_is_days_ahead_is_not_believed() -> None:
    hour, days = ((_NOW + ahead).timestamp() for ahead in (timedelta(hours=1), 3 * _DAY))
    assert _time_of(None, [hour], _NOW) == (_NOW + timedelta(hours=1), "metadata")
    assert _time_of(None, [hour, days], _NOW) == (_NOW, "received")
