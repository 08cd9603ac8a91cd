"""Behind a reverse proxy, under a path of its: every address leads back through it, and its word counts by setting."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urljoin

import httpx
import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.made_scene import add_scene
from tests.api.proxy import proxied
from tests.api.served import served
from tests.api.uploaded import zipped

_PREFIX = "/robots/splat"


@pytest.fixture(scope="module")
def behind(api_settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str]]:
    """The address of a server behind a proxy that it trusts, and a scene of it."""
    more = {
        "data_dir": tmp_path_factory.mktemp("behind"),
        "root_path": _PREFIX,
        "trusted_proxies": ("127.0.0.1",),
        "auth": "off",
    }
    settings = api_settings.model_copy(update=more)
    with open_service(settings) as service, served(service, settings) as faces:
        scene_id = add_scene(service, settings)
        with proxied(faces.ports.http, _PREFIX) as url:
            yield url, scene_id


@pytest.mark.parametrize("page", ["/", "/docs"])
def test_every_address_of_a_page_leads_through_the_proxy(behind: tuple[str, str], page: str) -> None:
    url, _ = behind
    response = httpx.get(url + page, timeout=60)
    addresses = re.findall(r"""(?:href|src|url)\s*[=:]\s*["']([^"'#]+)["']""", response.text)
    assert response.status_code == 200 and len(addresses) >= 3
    for address in addresses:
        target = urljoin(url + page, address)
        assert target.startswith(f"{url}/"), address
        assert httpx.get(target, timeout=60).status_code == 200, address


def test_the_addresses_in_answers_are_the_proxys(behind: tuple[str, str]) -> None:
    url, _ = behind
    document = httpx.get(f"{url}/openapi.json", timeout=60).json()
    assert document["servers"] == [{"url": _PREFIX}]
    announced = {"Tus-Resumable": "1.0.0", "Upload-Length": "3", "Upload-Metadata": "filename YS56aXA="}
    upload = httpx.post(f"{url}/v1/uploads", headers=announced, timeout=60)
    there = urljoin(f"{url}/v1/uploads", upload.headers["location"])
    assert httpx.head(there, headers=announced, timeout=60).headers["upload-length"] == "3"
    posted = httpx.post(f"{url}/v1/scenes", files={"capture": ("capture.zip", zipped(3))}, timeout=60)
    there = urljoin(f"{url}/v1/scenes", posted.headers["location"])
    assert httpx.get(there, timeout=60).json()["id"] == posted.json()["id"]


def test_the_client_works_through_the_proxy(behind: tuple[str, str], tmp_path: Path) -> None:
    url, scene_id = behind
    (tmp_path / "capture.zip").write_bytes(zipped(3))
    with Client(url, piece_bytes=1_000) as client:
        assert client.query(scene_id, "mug")[0].outcome == "here"
        operation = client.create_scene(tmp_path / "capture.zip")
        assert client.operation(operation.id).scene_id == operation.scene_id


@pytest.mark.parametrize("trusted", [(), ("192.0.2.1",), ("127.0.0.1",), ("127.0.0.0/8",)], ids=str)
def test_what_a_proxy_says_of_the_caller_counts_only_if_it_is_trusted(
    service: SceneService, api_settings: Settings, trusted: tuple[str, ...], caplog: pytest.LogCaptureFixture
) -> None:
    settings = api_settings.model_copy(update={"trusted_proxies": trusted})
    believed = trusted and trusted[0].startswith("127.")
    with caplog.at_level(logging.INFO), served(service, settings) as faces, proxied(faces.ports.http, "/p") as url:
        response = httpx.get(f"{url}/v1/server", headers={"X-Request-Id": "through-the-proxy"}, timeout=60)
    assert response.status_code == 200
    (line,) = (record for record in caplog.records if getattr(record, "request_id", "") == "through-the-proxy")
    assert vars(line)["peer"] == ("203.0.113.7" if believed else "127.0.0.1")
    assert ("strict-transport-security" in response.headers) == bool(believed)  # it says that it came by https
    assert "robots.example" not in str(response.headers)


def test_grpc_believes_nobody_about_the_caller(
    service: SceneService, api_settings: Settings, caplog: pytest.LogCaptureFixture
) -> None:
    settings = api_settings.model_copy(update={"trusted_proxies": ("127.0.0.1",)})
    metadata = (("x-request-id", "straight"), ("x-forwarded-for", "203.0.113.7"))
    with caplog.at_level(logging.INFO), served(service, settings) as faces:
        faces.rpc.ListScenes(pb.ListScenesRequest(), metadata=metadata)
    (line,) = (record for record in caplog.records if getattr(record, "request_id", "") == "straight")
    assert vars(line)["peer"] == "127.0.0.1"
