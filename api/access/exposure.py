"""Network exposure of a server without keys: loopback only, no pages of other sites."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from fastsplat_contract.errors import InvalidInputError, PermissionDeniedError

if TYPE_CHECKING:  # keeps commands without a server light
    from fastsplat.service.settings import Settings


def is_loopback(host: str) -> bool:
    """Returns True for loopback addresses and "localhost"."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def check_exposure(settings: Settings) -> None:
    """Raises `InvalidInputError` if keys are off and `host` or a CORS origin is not loopback."""
    if settings.auth == "off" and not is_loopback(settings.host):
        raise InvalidInputError(
            f"without keys the server does not listen on {settings.host}",
            field="auth",
            limit="loopback (FASTSPLAT_HOST=127.0.0.1)",
            hint="Leave FASTSPLAT_AUTH on, or bind to loopback.",
        )
    for origin in settings.cors_origins if settings.auth == "off" else ():
        if not is_loopback(_host_of(origin)):
            raise InvalidInputError(
                f"without keys no page of {origin[:80]!r} is answered",
                field="cors_origins",
                limit="origins of this machine (FASTSPLAT_CORS_ORIGINS), as http://localhost:3000",
                hint="Leave FASTSPLAT_AUTH on, or take the origin out.",
            )


def check_local(headers: Mapping[str, str]) -> None:
    """Refuses browser requests from pages of other sites, for servers without keys.

    Such requests carry the site's name as `Origin` or, with DNS rebinding, as `Host`. Image requests carry no origin
    but `Sec-Fetch-Site: cross-site`.

    Raises:
        PermissionDeniedError: one of the three headers names another site.
    """
    origin = headers.get("origin", "")
    # A page of http://localhost is cross-site to http://127.0.0.1; CORS decides whether it may read the answer.
    if headers.get("sec-fetch-site") == "cross-site" and not is_loopback(_host_of(origin)):
        raise PermissionDeniedError(
            "without keys, requests from pages of other sites are refused",
            field="sec-fetch-site",
            hint="Switch the keys on.",
        )
    for name in ("host", "origin"):
        value = headers.get(name, "")
        host = _host_of(value)
        if value and not is_loopback(host):
            raise PermissionDeniedError(
                f"without keys, requests for or from {host[:80]!r} are refused",
                field=name,
                hint="Ask http://localhost, or switch the keys on.",
            )


def _host_of(value: str) -> str:
    """Parses the host of an Origin or Host header; "" unless in plain form."""
    try:
        parts = urlsplit(value if "://" in value else f"http://{value}")
        host, port = parts.hostname or "", parts.port
    except ValueError:
        return ""
    plain = f"[{host}]" if ":" in host else host
    plain += "" if port is None else f":{port}"
    whole = parts.scheme in ("http", "https") and parts.netloc.lower() == plain
    return host if whole and value.endswith(parts.netloc) else ""
