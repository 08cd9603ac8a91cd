"""The stages of a job that withdraws photos from a finished scene: those of one that makes a scene, of the others."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fastsplat.service.capture.formats.capture_files import save_capture
from fastsplat.service.common.progress import Progress
from fastsplat.service.scene.scene_files import read_scene
from fastsplat.service.withdrawal import capture_without, with_joined_cameras
from fastsplat.workers import create_scene_stages
from fastsplat.workers.protocol import Job, Stage


def _capture(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "capture": what is kept of the capture, without the photos that go."""
    assert job.base is not None
    trained, current = (read_scene(each / "artefact") for each in (job.base[0], job.upload))
    scene, photos = with_joined_cameras(trained, current), tuple(job.order["photos"])
    capture = capture_without(scene, job.upload, folder, photos, job.settings.capture, progress)
    save_capture(capture, folder)


STAGES: Mapping[str, Stage] = {**create_scene_stages.STAGES, "capture": _capture}
