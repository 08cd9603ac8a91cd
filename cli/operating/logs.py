"""Logs on stderr, a JSON line a record or plain text, without passwords in URLs and access keys."""

from __future__ import annotations

import json
import logging
import re
import sys
import time
from typing import Any

_PASSWORD = re.compile(r"(\w+://[^\s:/@]+):[^\s/@]+@")
_KEY = re.compile(r"fsk_([0-9a-f]{12})_[A-Za-z0-9_-]+")
_STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName", "color_message"}


class JsonLines(logging.Formatter):
    """A record as one JSON object: time (UTC), level, role, logger, message, extra fields, trace."""

    def __init__(self, role: str) -> None:
        super().__init__()
        self._role = role

    def format(self, record: logging.LogRecord) -> str:
        """One line without line breaks."""
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        line: dict[str, Any] = {
            "time": f"{stamp}.{int(record.msecs):03d}Z",
            "level": record.levelname,
            "role": self._role,
            "logger": record.name,
            "message": record.getMessage(),
        }
        line.update({name: value for name, value in vars(record).items() if name not in _STANDARD})
        if record.exc_info:
            line["trace"] = self.formatException(record.exc_info)
        return _masked(json.dumps(line, default=str, ensure_ascii=False))


class PlainLines(logging.Formatter):
    """A record for people: local time, role, level from warnings on, message, trace."""

    def __init__(self, role: str) -> None:
        super().__init__("{asctime} {role:<6} {notice}{message}", "%H:%M:%S", "{", defaults={"role": role})

    def format(self, record: logging.LogRecord) -> str:
        """A line, and those of a trace."""
        record.notice = f"{record.levelname}: " if record.levelno >= logging.WARNING else ""
        return _masked(super().format(record))


def _masked(text: str) -> str:
    return _KEY.sub(r"fsk_\1_***", _PASSWORD.sub(r"\1:***@", text))


def log_to_stderr(role: str) -> None:
    """Send every logger of this process to stderr: as JSON lines, to a terminal as plain ones."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(PlainLines(role) if sys.stderr.isatty() else JsonLines(role))
    logging.getLogger("alembic.runtime.plugins").setLevel(logging.WARNING)  # it lists what it consists of
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
