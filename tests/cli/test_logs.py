"""Log lines: one JSON object each, without passwords."""

from __future__ import annotations

import json
import logging
import sys

from fastsplat.cli.operating.logs import JsonLines


def line(message: str, *values: object, **extra: object) -> dict[str, object]:
    record = logging.LogRecord("room", logging.WARNING, __file__, 1, message, values, None)
    vars(record).update(extra)
    text = JsonLines("worker").format(record)
    assert "\n" not in text
    parsed: dict[str, object] = json.loads(text)
    return parsed


def test_a_record_is_one_object_with_its_extras():
    parsed = line("two\nlines of %s", "text", operation="op1")
    assert parsed["message"] == "two\nlines of text" and parsed["operation"] == "op1"
    assert (parsed["level"], parsed["role"], parsed["logger"]) == ("WARNING", "worker", "room")


def test_a_trace_is_kept():
    try:
        raise ValueError("no")
    except ValueError:
        record = logging.LogRecord("room", logging.ERROR, __file__, 1, "bad", (), sys.exc_info())
    assert "ValueError: no" in json.loads(JsonLines("api").format(record))["trace"]


def test_access_keys_are_not_told():
    key = "fsk_0123456789ab_" + "aB-_" * 10 + "xyz"
    parsed = line("opened by %s", key, header=f"Bearer {key}", deep={"a": [key]})
    assert parsed["message"] == "opened by fsk_0123456789ab_***"
    assert "aB-_" not in json.dumps(parsed)


def test_passwords_in_urls_are_not_told():
    parsed = line("cannot reach postgresql+psycopg://user:secret@host:5432/db")
    assert parsed["message"] == "cannot reach postgresql+psycopg://user:***@host:5432/db"
