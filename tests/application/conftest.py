"""A service over a fresh folder, and scenes made ready without a worker."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.settings import Settings, StoreOptions
from fastsplat.service.store.store import open_store
from fastsplat_contract.errors import CorruptImageError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.jobs.operations import SceneOptions
from fastsplat_contract.messages.scenes import Scene as SceneInfo
from tests.scenes import finish_job, labelled_scene, stand_in_models

LABELS = ("mug", "banana")
ENCODER = "minilm_l6_int8"


def _admit(folder: Path, settings: CaptureSettings, strict: bool) -> ValidatedUpload:
    """Stands for the capture room: refuses what is called bad, unpacks what is called zip."""
    names = [path.name for path in folder.rglob("*") if path.is_file()]
    if "bad.jpg" in names:
        (folder.parent / "half-unpacked").mkdir()
        raise CorruptImageError("bad.jpg ends early", field="bad.jpg")
    if "all.zip" in names:
        (folder.parent / "unpacked").mkdir()
        (folder.parent / "unpacked" / "a.jpg").write_bytes(b"picture")
        return ValidatedUpload(folder.parent / "unpacked", "images", 1)
    return ValidatedUpload(folder, "images", len(names), has_labels="labels.json" in names)


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return Settings(
        data_dir=tmp_path / "data",
        models=stand_in_models(tmp_path / "stand-ins", ENCODER),
        capture=CaptureSettings(max_upload_bytes=1000, max_entries=5),
        query=QuerySettings(backend="reference", max_poses=3),
        store=StoreOptions(max_page_size=4, max_labels=3, max_gaussians=100),
    )


@pytest.fixture
def service(settings: Settings) -> Iterator[SceneService]:
    """A service whose uploads are checked by `_admit`."""
    with open_service(settings, _admit) as service:
        yield service


@pytest.fixture
def another(settings: Settings) -> Callable[[], SceneService]:
    """Opens one more service on the same folder."""
    return lambda: open_service(settings, _admit)


@pytest.fixture
def post(service: SceneService) -> Callable[..., SceneInfo]:
    """Posts one file and returns the scene that is to be made of it."""

    def post(name: str = "a place", request_id: str = "", content: bytes = b"picture") -> SceneInfo:
        with service.new_upload() as upload:
            upload.write("a.jpg", [content])
            operation = service.create_scene(upload, name, request_id, SceneOptions())
        return service.get_scene(operation.scene_id)

    return post


@pytest.fixture
def finish(settings: Settings, models_dir: Path) -> Iterator[Callable[[SceneInfo], Scene]]:
    """Ends a scene's job as a worker would: a mug on the left and a banana on the right of one camera."""
    store = open_store(settings.data_dir)
    encoder = open_text_encoder(ENCODER, models_dir)

    def finish(info: SceneInfo) -> Scene:
        scene = _two_objects(encoder)
        # "confidence" is in the row, and not in what a caller is shown.
        finish_job(store, info.operation_id, scene, version="v1", aliases=["cup"], pixels=9, views=1, confidence=0.5)
        return scene

    yield finish
    store.close()


def _two_objects(encoder: TextEncoder) -> Scene:
    sh = np.zeros((2, 1, 3))
    sh[0, 0, 0] = sh[1, 0, 1] = 1.5
    return labelled_scene(
        [[-0.5, 0, 2], [0.5, 0, 2]],
        [1, 2],
        LABELS,
        scales=0.15,
        sh=sh,
        encoder=encoder,
        templates=QuerySettings().templates,
        cameras=[PosedCamera(Camera(40, 30, 40.0, 40.0, 20.0, 15.0), np.eye(4), "front.jpg")],
        quality={"psnr": 31.0},
    )
