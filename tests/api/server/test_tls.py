"""TLS on both ports, from one certificate; clients may have to show one too."""

from __future__ import annotations

import ssl
from pathlib import Path

import grpc
import httpx
import pytest

from fastsplat.api.server import Ports
from fastsplat.api.tls import tls_of
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_client.stream import SceneServiceStub
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import serving


def _rest(ports: Ports, pem: Path, client: str = "") -> httpx.Response:
    context = ssl.create_default_context(cafile=str(pem / "ca.pem"))
    if client:
        context.load_cert_chain(pem / f"{client}.pem", pem / f"{client}.key")
    return httpx.get(f"https://127.0.0.1:{ports.http}/v1/scenes", verify=context, timeout=60)


def _grpc(ports: Ports, pem: Path, client: str = "") -> None:
    pair = ((pem / f"{client}.key").read_bytes(), (pem / f"{client}.pem").read_bytes()) if client else (None, None)
    credentials = grpc.ssl_channel_credentials((pem / "ca.pem").read_bytes(), *pair)
    with grpc.secure_channel(f"127.0.0.1:{ports.grpc}", credentials) as channel:
        SceneServiceStub(channel).ListScenes(pb.ListScenesRequest(), timeout=20)


def test_both_ports_speak_tls_and_nothing_else(service: SceneService, api_settings: Settings, pem: Path) -> None:
    files = {"tls_cert": pem / "server.pem", "tls_key": pem / "server.key"}
    with serving(service, api_settings.model_copy(update=files)) as ports:
        answer = _rest(ports, pem)
        assert answer.status_code == 200 and "max-age" in answer.headers["strict-transport-security"]
        _grpc(ports, pem)
        with pytest.raises(httpx.TransportError):
            httpx.get(f"http://127.0.0.1:{ports.http}/livez", timeout=60)
        with grpc.insecure_channel(f"127.0.0.1:{ports.grpc}") as channel, pytest.raises(grpc.RpcError):
            SceneServiceStub(channel).ListScenes(pb.ListScenesRequest(), timeout=5)


def test_clients_may_have_to_show_a_certificate(service: SceneService, api_settings: Settings, pem: Path) -> None:
    files = {"tls_cert": pem / "server.pem", "tls_key": pem / "server.key", "tls_client_ca": pem / "ca.pem"}
    with serving(service, api_settings.model_copy(update=files)) as ports:
        assert _rest(ports, pem, "client").status_code == 200
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
