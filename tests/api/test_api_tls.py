"""TLS on both ports, from one certificate; clients may have to show one too."""

from __future__ import annotations

import asyncio
import datetime
import ipaddress
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import grpc
import httpx
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from api.server import Ports, serve
from api.tls import tls_of
from fastsplat.v1 import fastsplat_pb2 as pb
from fastsplat.v1 import fastsplat_pb2_grpc as rpc
from service.calls.service import SceneService
from service.common.errors import InvalidInputError
from service.settings import Settings


@pytest.fixture(scope="module")
def pem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """server.pem and client.pem, signed by ca.pem; stranger.pem, signed by itself; a .key beside each."""
    folder = tmp_path_factory.mktemp("pem")
    authority = _write(folder, "ca", None)
    for name in ("server", "client"):
        _write(folder, name, authority)
    _write(folder, "stranger", None)
    return folder


def _write(folder: Path, name: str, issuer: tuple[x509.Certificate, Any] | None) -> tuple[x509.Certificate, Any]:
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.datetime.now(datetime.UTC)
    address = x509.IPAddress(ipaddress.ip_address("127.0.0.1"))
    certificate = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer[0].subject if issuer else subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(hours=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([address]), critical=False)
        .add_extension(x509.BasicConstraints(ca=issuer is None, path_length=None), critical=True)
        .sign(issuer[1] if issuer else key, hashes.SHA256())
    )
    (folder / f"{name}.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    (folder / f"{name}.key").write_bytes(private)
    return certificate, key


@contextmanager
def _serving(service: SceneService, settings: Settings) -> Iterator[Ports]:
    ready = threading.Event()
    state: dict[str, Any] = {}

    async def main() -> None:
        state["loop"], state["stop"] = asyncio.get_running_loop(), asyncio.Event()

        def on_ready(ports: Ports) -> None:
            state["ports"] = ports
            ready.set()

        await serve(service, settings, state["stop"], on_ready)

    thread = threading.Thread(target=lambda: asyncio.run(main()))
    thread.start()
    assert ready.wait(30)
    try:
        yield state["ports"]
    finally:
        state["loop"].call_soon_threadsafe(state["stop"].set)
        thread.join(60)


def _rest(ports: Ports, pem: Path, client: str = "") -> int:
    context = ssl.create_default_context(cafile=str(pem / "ca.pem"))
    if client:
        context.load_cert_chain(pem / f"{client}.pem", pem / f"{client}.key")
    return httpx.get(f"https://127.0.0.1:{ports.http}/v1/scenes", verify=context).status_code


def _grpc(ports: Ports, pem: Path, client: str = "") -> None:
    pair = ((pem / f"{client}.key").read_bytes(), (pem / f"{client}.pem").read_bytes()) if client else (None, None)
    credentials = grpc.ssl_channel_credentials((pem / "ca.pem").read_bytes(), *pair)
    with grpc.secure_channel(f"127.0.0.1:{ports.grpc}", credentials) as channel:
        rpc.SceneServiceStub(channel).ListScenes(pb.ListScenesRequest(), timeout=20)


def test_both_ports_speak_tls_and_nothing_else(service: SceneService, api_settings: Settings, pem: Path) -> None:
    files = {"tls_cert": pem / "server.pem", "tls_key": pem / "server.key"}
    with _serving(service, api_settings.model_copy(update=files)) as ports:
        assert _rest(ports, pem) == 200
        _grpc(ports, pem)
        with pytest.raises(httpx.TransportError):
            httpx.get(f"http://127.0.0.1:{ports.http}/livez")
        with grpc.insecure_channel(f"127.0.0.1:{ports.grpc}") as channel, pytest.raises(grpc.RpcError):
            rpc.SceneServiceStub(channel).ListScenes(pb.ListScenesRequest(), timeout=5)


def test_clients_may_have_to_show_a_certificate(service: SceneService, api_settings: Settings, pem: Path) -> None:
    files = {"tls_cert": pem / "server.pem", "tls_key": pem / "server.key", "tls_client_ca": pem / "ca.pem"}
    with _serving(service, api_settings.model_copy(update=files)) as ports:
        assert _rest(ports, pem, "client") == 200
        _grpc(ports, pem, "client")
        for client in ("", "stranger"):
            with pytest.raises(httpx.TransportError):
                _rest(ports, pem, client)
            with pytest.raises(grpc.RpcError):
                _grpc(ports, pem, client)


@pytest.mark.parametrize(
    ("cert", "key", "ca"),
    [
        ("server.pem", None, None),
        (None, "server.key", None),
        (None, None, "ca.pem"),
        ("server.pem", "client.key", None),
        ("missing.pem", "server.key", None),
        ("server.pem", "server.key", "server.key"),
    ],
)
def test_unusable_files_are_told_before_a_port_opens(pem: Path, cert: str, key: str, ca: str) -> None:
    files = {"tls_cert": cert, "tls_key": key, "tls_client_ca": ca}
    settings = Settings(**{name: pem / value for name, value in files.items() if value})
    with pytest.raises(InvalidInputError) as caught:
        tls_of(settings)
    assert caught.value.field.startswith("tls_") and "PEM" in caught.value.hint
    assert tls_of(Settings()) is None
