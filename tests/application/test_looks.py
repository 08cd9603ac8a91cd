"""A server whose settings name a calibrated image-text model answers by looks; one that nobody measured answers not."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.image_text import open_image_text
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.query.language.calibration import calibration_key
from fastsplat.service.query.language.probability import Logistic
from fastsplat.service.query.phrases import thing_looks
from fastsplat.service.query.phrases.thing_looks import LooksCalibration
from fastsplat.service.query.settings import QuerySettings
from fastsplat.service.scene.label_evidence import evidence_of
from fastsplat.service.scene.types import Looks, Thing, Things
from fastsplat.service.settings import Settings
from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.queries import QueryRequest
from fastsplat_contract.scenes import Edit
from tests.api.made_scene import ENCODER, write_words
from tests.looks_model import COLORS, MODEL, write_looks_model
from tests.scenes import finish_job, labelled_scene, queued_job

_CALIBRATION = LooksCalibration(ratio=Logistic(score=8.0, lead=2.0, offset=-4.0), date="2026-11-26", figures={})


@pytest.fixture
def service(tmp_path: Path) -> Iterator[SceneService]:
    write_words(tmp_path / "models", "crane")
    write_looks_model(tmp_path / "models")
    settings = Settings(
        data_dir=tmp_path,
        models=tmp_path / "models",
        perception=PerceptionSettings(text_encoder=ENCODER, image_text=MODEL),
        query=QuerySettings(backend="reference"),
    )
    with open_service(settings) as opened:
        yield opened


@pytest.fixture
def measured(service: SceneService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Calibrates the model from then on."""

    def measure() -> None:
        model = open_image_text(PerceptionSettings(image_text=MODEL), tmp_path / "models")
        known = {calibration_key(model.name, model.sha256): _CALIBRATION}
        monkeypatch.setattr(thing_looks, "_calibrations", lambda: known)

    return measure


def _scene(service: SceneService, models: Path) -> str:
    """Three things without names: red, green and blue."""
    sha256 = open_image_text(PerceptionSettings(image_text=MODEL), models).sha256
    rows = [np.array(color) / np.linalg.norm(color) for color in COLORS.values()]
    table = [Thing(n, looks=Looks(sha256, row.astype(np.float16).tobytes())) for n, row in enumerate(rows, start=1)]
    owner = np.repeat(np.arange(3), 20)
    means = np.array([0.0, 0.0, 4.0]) + np.outer(owner - 1.0, [1, 0, 0])
    means += 0.1 * np.random.default_rng(5).normal(size=means.shape)
    scene = labelled_scene(
        means,
        np.zeros(len(owner), int),
        (),
        encoder=open_text_encoder(ENCODER, models),
        templates=QuerySettings().templates,
        cameras=[PosedCamera(Camera(48, 36, 40.0, 40.0, 24.0, 18.0), np.eye(4), "front.png")],
        things=Things(tuple(table), evidence_of(np.arange(60), owner + 1, np.full(60, 4096), 60)),
    )
    job = queued_job()
    service._store.scenes.create(job)
    finish_job(service._store, job.operation_id, scene)
    return job.scene_id


def _asked(service: SceneService, scene_id: str) -> tuple[str, tuple[int, ...]]:
    (answer,) = service.answers.query(QueryRequest(scene_id, ("the red mug",))).answers
    return answer.outcome, answer.things


def _calibrated(service: SceneService) -> bool | None:
    (model,) = [each for each in service.status("operator", "").models if each.role == "image_text"]
    assert (model.name, model.state) == (MODEL, "ready")
    return model.calibrated


def test_a_calibrated_model_answers_by_looks_before_and_after_an_edit(
    service: SceneService, tmp_path: Path, measured: Callable[[], None]
) -> None:
    measured()
    assert _calibrated(service) is True
    scene_id = _scene(service, tmp_path / "models")
    assert _asked(service, scene_id) == ("probably_here", (1,))
    service.versions.edit(scene_id, [Edit("name", things=(2,), name="crane")])
    assert _asked(service, scene_id) == ("probably_here", (1,))
    service.versions.edit(scene_id, [Edit("discard", things=(1,))])
    assert _asked(service, scene_id)[1] == ()


def test_a_model_that_nobody_measured_answers_nothing_and_the_status_says_so(
    service: SceneService, tmp_path: Path
) -> None:
    assert _calibrated(service) is False
    assert _asked(service, _scene(service, tmp_path / "models"))[1] == ()
