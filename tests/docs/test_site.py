"""The documentation as a site: every link holds, every name is there, and nothing is loaded from elsewhere."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from html import unescape
from pathlib import Path

import pytest

import fastsplat
import fastsplat_client
from fastsplat_contract.v1 import fastsplat_pb2
from tests.docs.page_blocks import ROOT


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `make docs` builds it: strictly, which refuses links that lead nowhere."""
    target = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(target)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    return target


def test_every_page_is_there(site: Path) -> None:
    for page in (ROOT / "docs").glob("*.md"):
        assert (site / f"{page.stem}.html").is_file(), page.name


def test_every_route_is_described(site: Path) -> None:
    text = _text(site / "reference" / "rest.html")
    openapi = json.loads((ROOT / "api" / "rest" / "openapi.json").read_text())
    assert len(openapi["paths"]) > 40
    assert [path for path in openapi["paths"] if path not in text] == []
    assert [name for name in openapi["components"]["schemas"] if f"{name}" not in text] == []


def test_every_rpc_and_message_is_described(site: Path) -> None:
    text = _text(site / "reference" / "grpc.html")
    service = fastsplat_pb2.DESCRIPTOR.services_by_name["SceneService"]
    assert [method.name for method in service.methods if method.name not in text] == []
    assert [name for name in fastsplat_pb2.DESCRIPTOR.message_types_by_name if name not in text] == []
    assert "Upload a capture and queue its training." in text


def test_every_public_name_of_python_is_described(site: Path) -> None:
    html = (site / "reference" / "python.html").read_text()
    for name in fastsplat.__all__:
        assert f'id="fastsplat.{name}"' in html, name
    described = {name for name in fastsplat_client.__all__ if re.search(rf'id="fastsplat_\w+(\.\w+)*\.{name}"', html)}
    assert set(fastsplat_client.__all__) - described == set()
    assert "what raises" not in html and "world_from_camera" in html


def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    loads = re.compile(r"""<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=["']?(?:https?:)?//([^"'\s>]+)""")
    for page in site.rglob("*.html"):
        assert loads.findall(page.read_text()) == [], page.name
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(?:https?:)?//", sheet.read_text()), sheet.name


def _text(page: Path) -> str:
    return unescape(re.sub(r"<[^>]+>", "", page.read_text()))
