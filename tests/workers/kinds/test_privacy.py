"""The promise that no people are stored, kept by the whole service: a worker of its own, and the folders it leaves."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.service import open_service
from fastsplat.service.capture.photos.withholding import BLANK
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import ModelUnavailableError, NotFoundError
from fastsplat_contract.jobs.operations import SceneOptions
from tests import color_detector, color_segmenter
from tests.capture.views.test_withholding import _SIZE, _VIEWS, _WALKING, _figure, _upload
from tests.workers.deployment import post_folder, real_worker
from tests.workers.watched_sockets import seen, watching

_PERCEPTION = PerceptionSettings(
    closed_set_detector=color_detector.ADAPTER, segmenter=color_segmenter.ADAPTER, closer_look=False
)


@pytest.fixture
def settings(tmp_path: Path, models_dir: Path) -> Settings:
    """A server whose detector takes what is pure magenta for a person."""
    models = tmp_path / "models"
    models.mkdir()
    color_detector.write_color_detector(models)
    color_segmenter.write_color_segmenter(models)
    (models / "minilm_l6_int8").symlink_to(models_dir / "minilm_l6_int8")
    return Settings(data_dir=tmp_path / "data", models=models, perception=_PERCEPTION)


def _photos(test_data: Path, folder: Path) -> Path:
    color = np.broadcast_to(np.array(color_detector.COLOR, np.uint8), (*_SIZE[::-1], 3))
    return _upload(test_data / "tabletop", folder, lambda pixels, number: color)


def _sent_files(settings: Settings) -> list[Path]:
    return _stored(settings.data_dir / "uploads")


def _work(settings: Settings, watched: Path) -> AbstractContextManager[object]:
    training = {"iterations": 60, "time_budget_s": None, "max_side": 120, "max_gaussians": 4000}
    return real_worker(
        settings,
        watched,
        TRAINING=json.dumps(training),
        PERCEPTION=_PERCEPTION.model_dump_json(exclude_defaults=True, exclude={"closer_look"}),
        DISCOVERY='{"objects": "off"}',
    )


def _stored(root: Path, suffix: str = "") -> list[Path]:
    """All files of this kind; folders that a worker removes meanwhile are left out, where `Path.rglob` fails."""
    return [Path(folder) / name for folder, _, names in os.walk(root) for name in names if name.endswith(suffix)]


def test_nothing_of_a_person_is_stored_and_the_files_as_sent_go_first(
    test_data: Path, tmp_path: Path, settings: Settings
) -> None:
    watched = tmp_path / "watched"
    with _work(settings, watched), open_service(settings) as service:
        operation = post_folder(service, _photos(test_data, tmp_path / "table"), SceneOptions(privacy="people"))
        assert _sent_files(settings)
        deadline, early = time.monotonic() + 500, False
        while (now := service.get_operation(operation.id)).state in ("QUEUED", "RUNNING"):
            assert time.monotonic() < deadline, now
            if any(stage.stage == "training" for stage in now.stages):
                early = early or not _sent_files(settings)
            time.sleep(0.2)
        assert now.state == "SUCCEEDED", now.error
        assert early and not _sent_files(settings)

        withheld = service.get_scene(operation.scene_id).quality["withheld"]
        assert withheld["privacy"] == "people" and withheld["photos"] == len(_WALKING) and withheld["share"] > 0.02
        verdicts = service.list_photo_verdicts(operation.scene_id).photos
        shares = [verdict.withheld for verdict in verdicts]
        assert [share > 0 for share in shares] == [view in _WALKING for view in range(_VIEWS)]
        for view in _WALKING:  # what is withheld is more than the figure, but not much more
            assert _figure(view).mean() < shares[view] < 3 * _figure(view).mean()
        assert service.get_scene(operation.scene_id).dictionary == ()

        pictures = _stored(settings.data_dir / "scenes", ".jpg")
        assert len(pictures) == _VIEWS
        for path in [*_stored(settings.data_dir, ".jpg"), *_stored(settings.data_dir, ".png")]:
            try:
                pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
            except FileNotFoundError:  # of the job's own folder, which its worker removes meanwhile
                continue
            assert not ((pixels[..., 0] > 200) & (pixels[..., 1] < 80) & (pixels[..., 2] > 200)).any()
        stored = np.asarray(Image.open(sorted(pictures)[_WALKING[0]])).astype(int)
        assert np.abs(stored[_figure(_WALKING[0])] - BLANK).mean() < 8
    assert not seen(watched)  # no host was looked up, connected to, or sent anything


def test_a_connection_of_a_process_and_of_its_children_is_seen(tmp_path: Path) -> None:
    connecting = "import socket; socket.socket(socket.AF_INET, socket.SOCK_DGRAM).connect(('127.0.0.1', 9))"
    code = f"import subprocess, sys; {connecting}; subprocess.run([sys.executable, '-c', {connecting!r}], check=True)"
    environment = watching(tmp_path / "watched", os.environ)
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    lines = seen(tmp_path / "watched")
    assert len(lines) == 2 and len({line.split()[0] for line in lines}) == 2
    assert all(line.endswith("socket.connect ('127.0.0.1', 9)") for line in lines)


def test_a_promise_that_cannot_be_kept_is_refused(test_data: Path, tmp_path: Path, settings: Settings) -> None:
    folder = _photos(test_data, tmp_path / "table")
    blind = settings.perception.model_copy(update={"people_words": ("passer-by",)})
    with open_service(settings.model_copy(update={"perception": blind})) as service:
        with pytest.raises(ModelUnavailableError) as caught:
            post_folder(service, folder, SceneOptions(privacy="people"))
        assert "passer-by" in caught.value.message and caught.value.field == "privacy" and caught.value.hint
        assert not _sent_files(settings)


def test_a_promised_upload_does_not_outlive_its_job(test_data: Path, tmp_path: Path, settings: Settings) -> None:
    """Of other jobs it stays for a retry."""
    folder = _photos(test_data, tmp_path / "table")
    with open_service(settings) as service:
        usual = post_folder(service, folder, SceneOptions())
        assert service.cancel_operation(usual.id).state == "CANCELLED" and _sent_files(settings)
        assert service.retry_operation(usual.id).state == "QUEUED"
        service.delete_scene(usual.scene_id)
        promised = post_folder(service, folder, SceneOptions(privacy="people"))
        assert _sent_files(settings)
        assert service.cancel_operation(promised.id).state == "CANCELLED" and not _sent_files(settings)
        with pytest.raises(NotFoundError):
            service.retry_operation(promised.id)
