"""Where other machines reach the page, and what a server says of itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.application.admin.server_capabilities import _digest, page_addresses, weighed_with_encoder
from fastsplat.service.application.service import open_service
from fastsplat.service.perception.image_text import open_image_text
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.language.meaning.common_objects import all_common_objects
from fastsplat.service.query.phrases.looks_files import save_calibration
from fastsplat.service.settings import QuotaSettings, Settings
from tests.api.made_scene import ENCODER, write_words
from tests.looks_model import MODEL, calibration_of, write_looks_model
from tests.scenes import queued_job


@pytest.mark.parametrize(
    ("host", "more", "addresses"),
    [
        ("127.0.0.1", {}, ()),
        ("localhost", {}, ()),
        ("::1", {}, ()),
        ("192.168.7.20", {}, ("http://192.168.7.20:8000/",)),
        ("192.168.7.20", {"root_path": "/splat"}, ("http://192.168.7.20:8000/splat/",)),
        ("splat.example", {}, ("http://splat.example:8000/",)),
        ("fd00::7", {}, ("http://[fd00::7]:8000/",)),
        ("192.168.7.20", {"http_port": 0}, ()),
        ("127.0.0.1", {"page_address": "https://splat.example/here"}, ("https://splat.example/here/",)),
    ],
)
def test_only_an_address_that_is_known_is_offered(host: str, more: dict[str, object], addresses: object) -> None:
    assert page_addresses(Settings(host=host, **more)) == addresses


def test_a_server_that_listens_everywhere_offers_its_own_address_or_none() -> None:
    addresses = page_addresses(Settings(host="0.0.0.0"))
    assert len(addresses) <= 1
    assert all(":8000/" in address and "127.0.0.1" not in address and "0.0.0.0" not in address for address in addresses)


def test_quotas_are_those_of_the_project_and_only_workers_that_live_count(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, quotas=QuotaSettings(scenes=5, stored_bytes=0, queued_jobs=7))
    with open_service(settings) as service:
        service._store.workers.update_heartbeat("alive", "here", 1)
        service._store.workers.update_heartbeat("stopped", "here", 2)
        service._store.workers.mark_stopped("stopped")
        service._store.scenes.create(queued_job())
        status = service.status("operator", "")
        assert status.workers == 1
        assert [(quota.kind, quota.limit) for quota in status.quotas] == [("scenes", 5), ("bytes", None), ("jobs", 7)]
        assert {quota.kind: quota.used for quota in status.quotas}["jobs"] == 1
        service.admin.projects.create("elsewhere")
        project_status = service.in_project("elsewhere").status("operator", "")
        assert project_status.project == "elsewhere" and all(quota.used == 0 for quota in project_status.quotas)


def test_an_image_text_model_is_ready_and_then_calibrated(tmp_path: Path) -> None:
    models, perception, seen = tmp_path / "models", PerceptionSettings(image_text=MODEL), []
    write_looks_model(models)
    with open_service(Settings(data_dir=tmp_path, models=models, perception=perception)) as service:
        for _ in range(2):
            seen += [model for model in service.status("operator", "").models if model.role == "image_text"]
            opened, common = open_image_text(perception, models), np.zeros((len(all_common_objects()), 3), np.float16)
            save_calibration(calibration_of(opened), common, models)
    assert [(model.name, model.state, model.calibrated) for model in seen] == [
        (MODEL, "ready", calibrated) for calibrated in (False, True)
    ]


def test_an_encoder_that_comes_later_is_known_then(tmp_path: Path) -> None:
    """Models are pulled while the server runs; the lexicon may be there before the encoder."""
    settings = Settings(models=tmp_path, perception=PerceptionSettings(text_encoder=ENCODER))
    assert weighed_with_encoder(settings) is False
    assert _digest(ENCODER, tmp_path) is None
    write_words(tmp_path)
    assert _digest(ENCODER, tmp_path) == open_text_encoder(ENCODER, tmp_path).sha256
