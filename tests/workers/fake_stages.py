"""Stages that do what the job's labels, or the texts it looks for, order.

"STAGE:sleep 30", "sleep_once" (attempt 1) sleep; "kill", "kill_once", "kill_in 2" (attempt 2) kill the trainer,
"kill_worker", "kill_worker_until 3" (first three attempts), "kill_worker_in 2" the worker; "fail" raises a typed error,
"defect" an untyped one; "until_finish" shows pictures until an early end; "draft" publishes one, "draft_kill_in 2" dies
amid one; "full" meets a full disk, "write 5" writes 5 MB; "environment" notes environment and niceness; "child" leaves
a grandchild, its id in the data folder.
"""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.scene.artefact.scene import Scene, SceneFacts
from fastsplat.service.store.rows.codec import camera_to_json
from fastsplat.workers.job.made_scenes import EDITS, read_edited
from fastsplat.workers.job.protocol import Job
from fastsplat.workers.job.results import checkpoint_folder
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.errors import ReconstructionError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.jobs.job_watching import Provisional
from fastsplat_contract.jobs.look_again import LookAgainResult

_NUMBERS = itertools.count(1)


def _obey(job: Job, stage: str, progress: Progress) -> None:
    with (job.settings.data_dir / "visits.txt").open("a") as visits:
        visits.write(f"{stage} {job.operation_id} {job.attempt} {os.getpid()}\n")
    progress(ProgressEvent(stage, 0.25, "at work", {"attempt": float(job.attempt)}))
    for order in _orders(job):
        where, _, what = order.partition(":")
        if where != stage:
            continue
        name, _, value = what.partition(" ")
        for ending, first, last in (("_once", 1, 1), ("_in", value, value), ("_until", 1, value)):
            if name.endswith(ending):
                name = name.removesuffix(ending) if int(first) <= job.attempt <= int(last) else ""
        if name == "sleep":
            time.sleep(float(value))
        elif name == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        elif name == "kill_worker":
            os.kill(os.getppid(), signal.SIGKILL)
            time.sleep(600)  # dies with its worker; without this the stage could be over before
        elif name == "environment":
            values: dict[str, object] = {
                name: os.environ.get(name) for name in ("CUDA_VISIBLE_DEVICES", "OMP_NUM_THREADS")
            }
            values["secrets"] = [
                name for name in os.environ if name.startswith(("AWS_", "RAY_", "FASTSPLAT_DATABASE_"))
            ]
            values["niceness"] = os.getpriority(os.PRIO_PROCESS, 0)
            (job.settings.data_dir / f"{job.operation_id}.json").write_text(json.dumps(values))
        elif name == "full":
            Path("/dev/full").write_bytes(b"more than there is room for")
        elif name == "write":
            (job.folder / "large.bin").write_bytes(bytes(int(value) << 20))
        elif name in ("until_told", "until_asked"):
            while not (job.settings.data_dir / f"{name.removeprefix('until_')}.txt").exists():
                time.sleep(0.05)
        elif name == "draft":
            _publish_draft(job, stage, progress)
        elif name == "draft_kill":
            (job.folder / "drafts" / ".half").mkdir(parents=True)
            os.kill(os.getpid(), signal.SIGKILL)
        elif name == "until_finish":
            _show_until_finish(job, stage, progress)
        elif name == "fail":
            raise ReconstructionError("the images show two places", hint="Post them as two scenes.", field="images")
        elif name == "defect":
            raise ZeroDivisionError("a defect")
        elif name == "child":
            child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
            (job.settings.data_dir / "grandchild.txt").write_text(str(child.pid))
    progress(ProgressEvent(stage, 1.0, "finished"))


def _orders(job: Job) -> tuple[str, ...]:
    """Of a job that asks a captioner they are in a file, as it has no texts."""
    if "asking" in job.stages:
        orders = job.settings.data_dir / "orders.txt"
        return tuple(orders.read_text().splitlines()) if orders.exists() else ()
    return tuple(job.order.get("texts", job.options.labels))


def _show_until_finish(job: Job, stage: str, progress: Progress) -> None:
    folder = job.folder / "progress"
    folder.mkdir(exist_ok=True)
    for number in itertools.count(1):
        name = f"preview-{job.attempt}-{number}.jpg"
        (folder / f".{name}").write_bytes(f"attempt {job.attempt} picture {number}".encode())
        (folder / f".{name}").rename(folder / name)
        info = {"step": number, "seconds": 0.1, "gaussians": 5, "psnr": None, "view": "a", "width": 8, "height": 6}
        metrics = {"iteration": float(number), "job_seconds_left": 100.0}
        progress(ProgressEvent(stage, 0.5, "training", metrics, {"preview": {"file": name, "info": info}}))
        if job.finish_mark.exists():
            return
        time.sleep(0.2)


def _publish_draft(job: Job, stage: str, progress: Progress) -> None:
    from fastsplat.workers.kinds.create_scene import carry_into, write_made

    drafts = job.folder / "drafts"
    name = f"{job.folder.name}-{stage}-{job.attempt}-{next(_NUMBERS)}"
    provisional = Provisional("points", 0.0) if stage == "perception" else Provisional("training", 0.5)
    scene = replace(_scene(job, draft=True), facts=SceneFacts(draft=provisional))
    (drafts / f".{name}").mkdir(parents=True)
    write_made(scene, drafts / f".{name}")
    assert not carry_into(job, scene, drafts / f".{name}")
    (drafts / f".{name}").rename(drafts / name)
    files = {"draft": {"file": name, "info": provisional._asdict()}}
    progress(ProgressEvent(stage, 0.5, "a draft", {}, files))


def _scene(job: Job, *, draft: bool = False) -> Scene:
    """A scene of five Gaussians; with an encoder three objects, of which a draft has fewer Gaussians and other ids."""
    from tests.scenes import labelled_scene  # the other stages start without it

    if (job.settings.models / "words").is_dir():
        from tests.workers.draft_scenes import of_objects

        return of_objects(job.settings.models, draft=draft)

    posed = PosedCamera(Camera(8, 6, 8.0, 8.0, 4.0, 3.0), np.eye(4), "a.png")
    means = np.random.default_rng(0).normal(size=(5, 3))
    return labelled_scene(means, np.zeros(5, int), ["mug", "box"], logit_opacities=0.0, cameras=[posed])


def _capture(job: Job, folder: Path, progress: Progress) -> None:
    _obey(job, "capture", progress)
    files = sorted(path.name for path in job.upload.iterdir())
    (folder / "files.json").write_text(json.dumps(files))


def _perception(job: Job, folder: Path, progress: Progress) -> None:
    _obey(job, "perception", progress)


def _training(job: Job, folder: Path, progress: Progress) -> None:
    counter = checkpoint_folder(job) / "counter.txt"
    steps = int(counter.read_text()) if counter.exists() else 0
    counter.write_text(str(steps + 1))
    _obey(job, "training", progress)
    (folder / "steps.txt").write_text(str(steps + 1))


def _export(job: Job, folder: Path, progress: Progress) -> None:
    if read_edited(job.folder / EDITS) is None:
        _assemble(job, folder)
    else:
        from fastsplat.workers.kinds.create_scene import export_made  # with PyTorch, which takes seconds

        export_made(job, folder, lambda: _assemble(job, folder))
    _obey(job, "export", progress)


def _assemble(job: Job, folder: Path) -> None:
    from tests.scenes import write_version

    scene = _scene(job)
    posed = scene.cameras[0]
    write_version(scene, folder)
    steps = int((job.result("training") / "steps.txt").read_text())
    summary = {
        "gaussians": len(scene.gaussians),
        "objects": 0,
        "scale": scene.scale,
        "dictionary": _rows(scene.dictionary),
        "cameras": [camera_to_json(posed)],
        "quality": {
            "psnr": 30.0,
            "steps": steps,
            "stopped_early": job.finish_mark.exists(),
            "stage_seconds": {"capture": 0.0},
        },
    }
    (folder / "summary.json").write_text(json.dumps(summary))


def _rows(dictionary: Dictionary) -> list[dict[str, object]]:
    return [
        {"label_id": n, "label": e.label, "aliases": [], "pixels": 1, "views": 1, "gaussian_count": 0}
        for n, e in enumerate(dictionary.entries, start=1)
    ]


def _looking(job: Job, folder: Path, progress: Progress) -> None:
    _obey(job, "looking", progress)
    (folder / "looked_at.txt").write_text(job.version)


def _naming(job: Job, folder: Path, progress: Progress) -> None:
    """Another scene of the same Gaussians, whose first label is what was looked for."""
    from fastsplat.service.scene.artefact.scene_files import read_scene
    from tests.scenes import write_version

    _obey(job, "naming", progress)
    scene = read_scene(job.upload / "artefact")
    texts = tuple(job.order["texts"])
    dictionary = Dictionary((replace(scene.dictionary.entries[0], label=texts[0]), *scene.dictionary.entries[1:]))
    write_version(replace(scene, dictionary=dictionary), folder)
    result = LookAgainResult("", texts, ("a.png",), True, (), (), 0, 0)
    summary = {
        "parent": job.version,
        "gaussians": len(scene.gaussians),
        "objects": 0,
        "dictionary": _rows(dictionary),
        "result": to_plain(result),
    }
    (folder / "summary.json").write_text(json.dumps(summary))


def _asking(job: Job, folder: Path, progress: Progress) -> None:
    """The real stage, then its orders."""
    from fastsplat.workers.kinds.naming import ASK_CAPTIONER

    ASK_CAPTIONER["asking"](job, folder, progress)
    _obey(job, "asking", progress)


def _suggesting(job: Job, folder: Path, progress: Progress) -> None:
    """Its orders, then the real stage."""
    from fastsplat.workers.kinds.naming import ASK_CAPTIONER

    _obey(job, "suggesting", progress)
    ASK_CAPTIONER["suggesting"](job, folder, progress)


FAKES = {
    "capture": _capture,
    "perception": _perception,
    "training": _training,
    "export": _export,
    "looking": _looking,
    "naming": _naming,
    "asking": _asking,
    "suggesting": _suggesting,
}
