"""TLS of both ports, from the same files."""

from __future__ import annotations

import ssl
from dataclasses import dataclass
from pathlib import Path

import grpc

from fastsplat.service.settings import Settings
from fastsplat_contract.errors import InvalidInputError


@dataclass(frozen=True)
class Tls:
    """PEM files of a server."""

    cert: Path  # certificate chain
    key: Path
    client_ca: Path | None  # CA certificates for mutual TLS

    def grpc_credentials(self) -> grpc.ServerCredentials:
        roots = None if self.client_ca is None else self.client_ca.read_bytes()
        pair = (self.key.read_bytes(), self.cert.read_bytes())
        return grpc.ssl_server_credentials([pair], roots, require_client_auth=roots is not None)

    def http_context(self) -> ssl.SSLContext:
        """Builds the HTTP port's context, TLS 1.2 or later. Raises `OSError` for unusable files."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.load_cert_chain(self.cert, self.key)
        if self.client_ca is not None:
            context.load_verify_locations(self.client_ca)
            context.verify_mode = ssl.CERT_REQUIRED
        return context


def tls_of(settings: Settings) -> Tls | None:
    """Returns the TLS files of the settings, after loading them once; None without any.

    Raises:
        InvalidInputError: the certificate or its key is not set, or the files are unreadable or do not match.
    """
    if settings.tls_cert is None and settings.tls_key is None and settings.tls_client_ca is None:
        return None
    if settings.tls_cert is None or settings.tls_key is None:
        raise InvalidInputError(
            "TLS needs a certificate and its key",
            field="tls_cert" if settings.tls_cert is None else "tls_key",
            hint="Set FASTSPLAT_TLS_CERT and FASTSPLAT_TLS_KEY to PEM files.",
        )
    tls = Tls(settings.tls_cert, settings.tls_key, settings.tls_client_ca)
    try:
        tls.http_context()
    except OSError as error:  # ssl.SSLError is one
        raise InvalidInputError(
            f"the TLS files cannot be used: {error}",
            field="tls_cert",
            hint="FASTSPLAT_TLS_CERT, _KEY and _CLIENT_CA are PEM files; the key must be that of the certificate.",
        ) from error
    return tls
