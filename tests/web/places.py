"""Servers that the tests of the page share, and what a test adds to one for itself."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.settings import QuotaSettings, Settings
from fastsplat_contract.server.keys import Role
from tests import color_detector, color_segmenter
from tests.api.made_scene import ENCODER, write_words
from tests.api.served import on_free_ports, serving
from tests.web.table import add_table

MARKUP = "<b onclick=alert(1)>violin</b><script>alert(2)</script>"
"""A name that the text encoder knows, and that no page may take for markup."""

_OPEN_SET = "grounding_dino_tiny"  # never opened


@dataclass(frozen=True)
class Place:
    """A running server."""

    url: str
    service: SceneService
    settings: Settings
    scene_id: str = ""

    def new_scene(self, name: str = "a table") -> str:
        return add_table(self.service, self.settings, name)

    def new_key(self, role: Role) -> str:
        """An access key, where the server wants one."""
        return self.service.admin.keys.create(f"a {role}", role)[1]


def page_settings(folder: Path, **more: object) -> Settings:
    """Settings of a server that only the page's tests ask: no keys, small models that answer by arithmetic."""
    models = folder / "models"
    write_words(models, MARKUP)
    color_segmenter.write_color_segmenter(models)
    color_detector.write_color_detector(models)
    settings = on_free_ports(
        data_dir=folder / "data",
        models=models,
        perception=PerceptionSettings(
            text_encoder=ENCODER,
            closed_set_detector=color_detector.ADAPTER,
            open_set_detector=_OPEN_SET,
            segmenter=color_segmenter.ADAPTER,
        ),
        capture=CaptureSettings(max_upload_bytes=30_000_000),
        query=QuerySettings(backend="cpu", threshold=0.5, exact_threshold=0.95),
    )
    return settings.model_copy(update=more)


def small_settings(folder: Path) -> Settings:
    """Of a server with little room, and without a detector of names that it is told."""
    return page_settings(
        folder,
        quotas=QuotaSettings(scenes=1, stored_bytes=45_000),
        capture=CaptureSettings(max_upload_bytes=60_000, max_images=3),
        perception=PerceptionSettings(text_encoder=ENCODER, open_set_detector=""),
    )


def guarded_settings(folder: Path) -> Settings:
    """Of a server that wants keys and says where phones reach it."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    # For a phone of the test's own machine.
    return page_settings(folder, auth="on", http_port=port, page_address=f"http://localhost:{port}")


@contextmanager
def running(settings: Settings) -> Iterator[Place]:
    """A server of these settings, without a scene."""
    with open_service(settings) as service, serving(service, settings) as ports:
        yield Place(f"http://127.0.0.1:{ports.http}", service, settings)
