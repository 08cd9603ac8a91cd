"""Which releases of server and client fit each other; the same rule is in docs/operating.md."""

from __future__ import annotations

import re
import warnings
from importlib.metadata import PackageNotFoundError, version
from typing import TypeVar

from fastsplat_contract.server.server_info import ServerInfo
from fastsplat_contract.server.server_status import ServerStatus

Told = TypeVar("Told", ServerInfo, ServerStatus)


class ReleaseWarning(UserWarning):
    """Client and server are of releases that do not fit; calls may fail."""


def fitting(told: Told) -> Told:
    """What a server told of itself, as it is; warns by `ReleaseWarning` where its release does not fit the client's."""
    try:
        own = version("fastsplat-client")
    except PackageNotFoundError:  # its sources on a path, which have no release
        return told
    if said := advice(own, told.version):
        warnings.warn(said, ReleaseWarning, stacklevel=3)
    return told


def advice(client: str, server: str) -> str:
    """What to do about a client and a server of these releases; "" where they fit, or one is no release.

    A server answers clients of its own major release (below 1.0: of its own minor one) that are not newer than it. Only
    major and minor numbers count.
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
