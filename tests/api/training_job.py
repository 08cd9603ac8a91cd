"""A job that trains, as its worker reports it, without a worker."""

from __future__ import annotations

import time
import uuid

import numpy as np
from sqlalchemy import update

from fastsplat.service.application.service import SceneService
from fastsplat.service.capture.formats.image_io import PhotoInfo
from fastsplat.service.capture.formats.upload_manifest import VALIDATED, UploadManifest, write_manifest
from fastsplat.service.capture.sfm.placed_cameras import PlacedViews, placed_to_json
from fastsplat.service.store.queue.claims import Claim
from fastsplat.service.store.rows.records import NewJob
from fastsplat.service.store.rows.schema import operations
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.capture.upload_files import encoded
from tests.scenes import claimed_job


def add_training_job(service: SceneService, name: str = "") -> Claim:
    """A claimed job with 300 steps of training, a log, a picture and two of three cameras."""
    job = NewJob(uuid.uuid4().hex, uuid.uuid4().hex, name, "", "", "none", {"labels": []})
    claim = claimed_job(service._store, job)
    log = service._store.blobs.log(job.operation_id)
    log.parent.mkdir(exist_ok=True)
    log.write_text("step 300")
    show_training(service, claim, 1)
    return claim


def add_cancelled_job(service: SceneService, photo: str) -> str:
    """Id of a job of three photos, one of this name, that was cancelled in the queue."""
    options = {"labels": [], "validated": VALIDATED}
    job = NewJob(uuid.uuid4().hex, uuid.uuid4().hex, "", "", "", uuid.uuid4().hex, options)
    names = (photo, "another.jpg", "a third.jpg")
    photos = tuple(PhotoInfo(name, 32, 24, 1, "", 0.0) for name in names)
    folder = service._store.blobs.upload(job.upload_id) / VALIDATED
    folder.mkdir(parents=True)
    write_manifest(UploadManifest("images", photos, names), folder)
    service._store.scenes.create(job)
    service.cancel_operation(job.operation_id)
    return job.operation_id


def show_training(service: SceneService, claim: Claim, number: int) -> None:
    """What the worker reports when it has so many pictures: each is as blue as its number, and 32 by 24 pixels."""
    store, run_id = service._store, claim.operation.run_id
    preview, placed = f"preview-1-{number}.jpg", "placed-1-1.json"
    for file, content in ((preview, picture(number)), (placed, placed_to_json(_placed()))):
        path = store.blobs.progress_file(run_id, file)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        store.blobs.keep_progress_file(run_id, file)
    info = {
        "number": number, "step": 300 * number, "seconds": 4.0 * number, "gaussians": 1_000, "psnr": 20.0 + number,
        "view": "a.png", "width": 32, "height": 24,
    }  # fmt: skip
    files = {
        "preview": {"file": preview, "info": info},
        "placed": {"file": placed, "info": {"number": 1, "placed": 2, "images": 3, "complete": True}},
    }
    capture = {"stage": "capture", "fraction": 1.0, "message": "done", "seconds": 12.0, "metrics": {}}
    metrics = {"iteration": 300.0 * number, "job_seconds_left": 200.0 - number}
    training = {"stage": "training", "fraction": 0.25, "message": "", "seconds": 4.0, "metrics": metrics}
    store.jobs.report(claim, [capture, training], progress_files=files)


def picture(number: int) -> bytes:
    """The picture of that number, as JPEG."""
    pixels = np.zeros((24, 32, 3), np.uint8)
    pixels[..., 2] = 20 * number
    return encoded(pixels, "JPEG")


def _placed() -> PlacedViews:
    poses = [np.eye(4), np.eye(4)]
    poses[1][0, 3] = 1.0
    camera = Camera(32, 24, 30.0, 30.0, 16.0, 12.0)
    cameras = tuple(PosedCamera(camera, pose, f"{n}.png") for n, pose in enumerate(poses))
    points = np.random.default_rng(0).normal(0, 0.4, (200, 3)).astype(np.float32) + np.float32([0.5, 0, 2])
    colors = np.random.default_rng(1).integers(40, 255, (200, 3), dtype=np.uint8)
    return PlacedViews(cameras, points, colors, placed=2, images=3, complete=True)


def make_old(service: SceneService, operation_id: str) -> None:
    """Make a job's last report an hour old."""
    with service._store.engine.begin() as connection:
        old = update(operations).values(updated_at=time.time() - 3600)
        connection.execute(old.where(operations.c.id == operation_id))
