"""Heads of HTTP requests that proxies and servers read differently are refused (RFC 9112, sections 3.2 and 6.1)."""

from __future__ import annotations

import re

from starlette.datastructures import Headers

from fastsplat_contract.errors import InvalidInputError, LimitExceededError

MAX_HEADERS = 100
"""Header lines of a request; browsers send about 20."""

_HOST = re.compile(r"([\w.~-]+|\[[0-9A-Fa-f:.%]+\])(:[0-9]{1,5})?")


class AmbiguousRequestError(InvalidInputError):
    """A head that can be read in two ways; the connection is closed, as what follows may be part of either."""


def check_head(headers: Headers, http_version: str) -> None:
    """Check what the router does not look at.

    Args:
        headers: of one request.
        http_version: "1.0", "1.1" or "2".

    Raises:
        AmbiguousRequestError: the body's length is said twice, or the host is none.
        LimitExceededError: more than `MAX_HEADERS` headers.
    """
    if len(headers.raw) > MAX_HEADERS:
        raise LimitExceededError(
            f"{len(headers.raw)} headers",
            field="headers",
            limit=f"{MAX_HEADERS} header lines",
            hint="Send only what the request needs.",
        )
    if "transfer-encoding" in headers and "content-length" in headers:
        raise AmbiguousRequestError(
            "a request with Transfer-Encoding and Content-Length",
            field="content-length",
            hint="Send one of the two.",
        )
    hosts = headers.getlist("host")
    if http_version == "1.0" and not hosts:
        return
    if len(hosts) != 1 or _HOST.fullmatch(hosts[0]) is None:
        raise AmbiguousRequestError(
            f"no host: {', '.join(hosts)[:80]!r}", field="host", hint="Send one Host header: a name, and a port."
        )
