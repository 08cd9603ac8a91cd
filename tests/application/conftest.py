"""A service over a fresh folder, and scenes made ready without a worker."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.types import ValidatedUpload
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.perception.text import open_text_encoder
from fastsplat.service.query import QuerySettings, embed_labels
from fastsplat.service.scene import Gaussians, Scene, SemanticHead, write_ply, write_scene
from fastsplat.service.settings import Settings, StoreSettings
from fastsplat.service.store import open_store
from fastsplat.service.store.codec import camera_to_json
from fastsplat.service.store.records import SceneSummary
from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.errors import CorruptImageError
from fastsplat_contract.operations import SceneOptions
from fastsplat_contract.scenes import Scene as SceneInfo

LABELS = ("mug", "banana")
ENCODER = "minilm_l6_int8"


def _admit(folder: Path, settings: CaptureSettings) -> ValidatedUpload:
    """Stands for the capture room: refuses what is called bad, unpacks what is called zip."""
    names = [path.name for path in folder.rglob("*") if path.is_file()]
    if "bad.jpg" in names:
        (folder.parent / "half-unpacked").mkdir()
        raise CorruptImageError("bad.jpg ends early", field="bad.jpg")
    if "all.zip" in names:
        (folder.parent / "unpacked").mkdir()
        (folder.parent / "unpacked" / "a.jpg").write_bytes(b"picture")
        return ValidatedUpload(folder.parent / "unpacked", "images", 1)
    return ValidatedUpload(folder, "images", len(names))


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    """Small limits, the readable rasterizer."""
    return Settings(
        data_dir=tmp_path / "data",
        capture=CaptureSettings(max_upload_bytes=1000, max_entries=5),
        query=QuerySettings(backend="reference", max_poses=3),
        store=StoreSettings(max_page_size=4, max_labels=3, max_gaussians=100),
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
            operation = upload.commit(name, request_id, SceneOptions())
        return service.get_scene(operation.scene_id)

    return post


@pytest.fixture
def finish(settings: Settings, models_dir: Path) -> Iterator[Callable[[SceneInfo], Scene]]:
    """Ends a scene's job as a worker would: a mug on the left and a banana on the right of one camera."""
    store = open_store(settings.data_dir)
    encoder = open_text_encoder(ENCODER, models_dir)

    def finish(info: SceneInfo) -> Scene:
        scene = _two_things(encoder)
        claim = store.jobs.claim(info.operation_id)
        assert claim is not None
        folder = store.blobs.job(info.operation_id)
        folder.mkdir(parents=True)
        write_scene(scene, folder / "artefact")
        write_ply(scene.gaussians, folder / "scene.ply")
        store.blobs.publish(folder, info.id, "v1")
        rows = [
            {"label_id": n, "label": label, "aliases": ["cup"], "pixels": 9, "views": 1, "gaussian_count": 1}
            | {"confidence": 0.5}  # in the row, and not in what a caller is shown
            for n, label in enumerate(LABELS, start=1)
        ]
        cameras = [camera_to_json(posed) for posed in scene.cameras]
        store.jobs.succeed(claim, SceneSummary("v1", 2, "METRIC", rows, cameras, {"psnr": 31.0}))
        return scene

    yield finish
    store.close()


def _two_things(encoder) -> Scene:
    sh = np.zeros((2, 1, 3), np.float32)
    sh[0, 0, 0] = sh[1, 0, 1] = 1.5
    gaussians = Gaussians(
        means=np.float32([[-0.5, 0, 2], [0.5, 0, 2]]),
        quats=np.float32([[1, 0, 0, 0]] * 2),
        log_scales=np.full((2, 3), np.log(0.15), np.float32),
        logit_opacities=np.full(2, 6, np.float32),
        sh=sh,
        codes=np.eye(2, dtype=np.float32),
    )
    head = SemanticHead(np.float32([[0, 0], [9, 0], [0, 9]]), np.float32([0, 0, 0]))
    dictionary = dictionary_of(LABELS)
    templates = QuerySettings().templates
    return Scene(
        gaussians,
        head,
        dictionary,
        embed_labels(dictionary, encoder, templates),
        (encoder.name, encoder.sha256),
        (PosedCamera(Camera(40, 30, 40.0, 40.0, 20.0, 15.0), np.eye(4), "front.jpg"),),
        "METRIC",
        label_templates=templates,
    )
