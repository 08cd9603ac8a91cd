"""Protection from request smuggling: ambiguous heads are refused (RFC 9112, sections 3.2 and 6.1)."""

from __future__ import annotations

import re

from starlette.datastructures import Headers

from fastsplat_contract.errors import InvalidInputError, LimitExceededError

MAX_HEADERS = 100
"""Header lines of a request; browsers send about 20."""

_HOST = re.compile(r"([\w.~-]+|\[[0-9A-Fa-f:.%]+\])(:[0-9]{1,5})?")


def find_ambiguity(headers: Headers, http_version: str) -> InvalidInputError | None:
    """What can be read in two ways; after the refusal the connection must end, as what follows may be part of either.

    Args:
        headers: of one request.
        http_version: "1.0", "1.1" or "2".
    """
    if "transfer-encoding" in headers and "content-length" in headers:
        return InvalidInputError(
            "a request with Transfer-Encoding and Content-Length",
            field="content-length",
            hint="Send one of the two.",
        )
    hosts = headers.getlist("host")
    if (http_version == "1.0" and not hosts) or (len(hosts) == 1 and _HOST.fullmatch(hosts[0])):
        return None
    return InvalidInputError(
        f"no host: {', '.join(hosts)[:80]!r}", field="host", hint="Send one Host header: a name, and a port."
    )


def check_header_count(headers: Headers) -> None:
    """Check that a request has at most `MAX_HEADERS` headers.

    Raises:
        LimitExceededError: it has more.
    """
    if len(headers.raw) > MAX_HEADERS:
        raise LimitExceededError(
            f"{len(headers.raw)} headers",
            field="headers",
            limit=f"{MAX_HEADERS} header lines",
            hint="Send only what the request needs.",
        )
