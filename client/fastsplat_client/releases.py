"""Compatibility of server and client releases; docs/operating.md states the same rule."""

from __future__ import annotations

import re
import warnings
from importlib.metadata import PackageNotFoundError, version
from typing import TypeVar

from fastsplat_contract.server.server_info import ServerInfo
from fastsplat_contract.server.server_status import ServerStatus

Reply = TypeVar("Reply", ServerInfo, ServerStatus)


class ReleaseWarning(UserWarning):
    """Client and server releases are incompatible; calls may fail."""


def fitting(reply: Reply) -> Reply:
    """Returns its argument; warns by `ReleaseWarning` if the server's release is incompatible."""
    try:
        release = version("fastsplat-client")
    except PackageNotFoundError:  # not installed, hence without a release
        return reply
    if said := advice(release, reply.version):
        warnings.warn(said, ReleaseWarning, stacklevel=3)
    return reply


def advice(client: str, server: str) -> str:
    """Explains how to fix incompatible releases; "" if they are compatible or unknown.

    A server supports clients of its own major release (below 1.0: its own minor one) that are not newer than itself.
    Only major and minor numbers count.
    """
    ours, theirs = _numbers(client), _numbers(server)
    if ours is None or theirs is None or ours == theirs:
        return ""
    breaking = ours[0] != theirs[0] or ours[0] == 0
    if not breaking and ours < theirs:
        return ""
    newer = f"the server to {client} or later" if theirs < ours else ""
    pin = f'pip install "fastsplat-client~={theirs[0]}.{theirs[1]}.0"'
    return f"this client is of release {client}, the server of {server}, and they do not fit: " + (
        f"upgrade {newer}, or run: {pin}" if newer else f"run: {pin}"
    )


def _numbers(release: str) -> tuple[int, int] | None:
    found = re.match(r"(\d+)\.(\d+)", release)
    return None if found is None else (int(found[1]), int(found[2]))
