"""Writes a release's small data folder and its answers, `told.json`, once: `python -m tests.store.released_folder`."""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
import zipfile
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.settings import Settings
from fastsplat_contract.messages.scenes import Edit
from tests.api.made_scene import ENCODER, add_known_name, add_scene, made_scene, write_words
from tests.api.training_job import add_cancelled_job
from tests.scenes import finish_job, queued_job

RELEASED = Path(__file__).with_name("released")
MOST_BYTES = 200_000
_PROJECT = "kitchen"


def minor_release() -> str:
    """As the file of its folder is called: "0.1"."""
    return ".".join(version("fastsplat").split(".")[:2])


def opened(folder: Path, models: Path) -> SceneService:
    perception = {"text_encoder": ENCODER}
    return open_service(Settings.model_validate({"data_dir": folder, "models": models, "perception": perception}))


def make(archive: Path) -> None:
    """Writes the folder of the release that runs; `FileExistsError` if it is there, `SystemExit` if too large."""
    with tempfile.TemporaryDirectory() as work_dir:
        folder, models = Path(work_dir) / "data", Path(work_dir) / "models"
        write_words(models)
        with opened(folder, models) as service:
            service.admin.keys.ensure_first(folder / "key")
            service.admin.projects.create(_PROJECT)
            service.admin.keys.create("robot", "reader", project=_PROJECT)
            scene = add_scene(service, service._context.settings, "edited")
            for edits in ([Edit("name", object_ids=(2,), name="beaker")], [Edit("remove", object_ids=(3,))]):
                service.versions.edit(scene, edits)
            service.versions.undo(scene)
            add_known_name(service, scene)
            job = replace(queued_job("as trained"), project=_PROJECT)
            store = service.in_project(_PROJECT)._store
            store.scenes.create(job)
            finish_job(store, job.operation_id, made_scene(open_text_encoder(ENCODER, models)))
            add_cancelled_job(service, "a.jpg")
            record = told_by(service)
        with zipfile.ZipFile(archive, "x", zipfile.ZIP_DEFLATED, compresslevel=9) as file:
            file.writestr("told.json", json.dumps(record, indent=1))
            for path in sorted(path for path in folder.rglob("*") if path.is_file() and path.name != ".reserve"):
                file.write(path, Path("data") / path.relative_to(folder))
    if archive.stat().st_size > MOST_BYTES:
        archive.unlink()
        raise SystemExit(f"the folder has more than {MOST_BYTES} bytes")


def told_by(service: SceneService) -> dict[str, Any]:
    """What a service tells of its scenes, their objects and versions, jobs and keys: what no later release may lose."""
    return {
        "scenes": {
            scene.name: _scene(project_service, scene.id)
            for project_service in (service, service.in_project(_PROJECT))
            for scene in project_service.list_scenes().scenes
            if scene.name
        },
        "jobs": sorted(operation.state for operation in service.list_operations().operations),
        "keys": sorted([key.id, key.project, key.role] for key in service.admin.keys.all()),
        "known": [[name.id, name.name] for name in service.known_names.list().names],
    }


def _scene(service: SceneService, scene_id: str) -> dict[str, Any]:
    scene, versions = service.get_scene(scene_id), service.versions.all(scene_id)
    return {
        "id": scene_id,
        "gaussians": scene.gaussians,
        "scale": scene.scale,
        "labels": sorted(label.label for label in service.list_labels(scene_id).labels),
        "objects": sorted([obj.id, obj.name] for obj in service.answers.list_objects(scene_id).objects),
        "versions": [version.version for version in versions],
        "photos": [
            hashlib.sha256(service.photos.path(scene_id, photo.view)[0].read_bytes()).hexdigest()
            for photo in service.photos.all(scene_id).photos
        ],
    }


if __name__ == "__main__":
    RELEASED.mkdir(exist_ok=True)
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else RELEASED / f"{minor_release()}.zip")
