"""Memory of answers is admitted before it is allocated: what is too large is refused, the rest takes turns."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.application.base.memory import MemoryBudget
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.common.call_scheduling import CallAgainError, run_by
from fastsplat.service.common.cancellation import Cancellation, cancellable
from fastsplat.service.settings import CallSettings, Settings
from fastsplat_contract.errors import CancelledError, LimitExceededError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.messages.scenes import Color, Edit
from fastsplat_contract.photos.pictures import PictureRequest

_STATUS = """
from pathlib import Path

def status(name):
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(name))
"""
_PEAKS = """
import json, sys
from dataclasses import replace
from pathlib import Path
from typing import get_args
import numpy as np
from fastsplat.service.application.answering.mask_encodings import encoded_mask
from fastsplat.service.application.base.memory import masks_bytes, picture_bytes
from fastsplat.service.application.answering.pictures import picture
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.language.words.query_text import check_query
from fastsplat.service.splatting.torch_runtime import release_free_memory
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.photos.pictures import (PictureKind, PictureRequest)
from tests.scenes import evidence_from_dense, labelled_scene

SIDE, COUNT = 1800, 30_000

def peak(work):
    release_free_memory()
    before = status("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")
    work()
    return status("VmHWM") - before

random = np.random.default_rng(0)
labels = np.arange(COUNT) % 2 + 1
encoder = open_text_encoder(sys.argv[1], Path(sys.argv[2]))
scene = labelled_scene(
    np.stack([random.uniform(-2, 2, COUNT), random.uniform(-2, 2, COUNT), random.uniform(2, 3, COUNT)], axis=1),
    labels, ("mug", "banana"), scales=0.02, encoder=encoder, templates=QuerySettings().templates,
)
sums = np.zeros((COUNT, 3)); sums[np.arange(COUNT), labels] = 50.0
query = check_query(("mug",), QuerySettings())
view = lambda side: PosedCamera(Camera(side, side, 0.8 * side, 0.8 * side, side / 2, side / 2), np.eye(4))

def draw(kind, posed):
    text = "mug" if kind in ("overlay", "relevancy", "mask") else None
    return picture(index, index.ranked, PictureRequest("scene", kind, text, camera=posed), query)

def masks(posed, encoding):
    (answer,) = index.ask(["mug"])
    assert encoded_mask(index.mask(answer, posed), "", 0, encoding).area > 0.1 * posed.camera.width**2

rows = {}
for mode in ("codes", "evidence"):
    index = SceneIndex(replace(scene, evidence=evidence_from_dense(sums) if mode == "evidence" else None), encoder)
    for kind in get_args(PictureKind):
        draw(kind, view(32))  # code and the scene's own arrays are loaded now
        rows[f"{kind} by {mode}"] = (peak(lambda: draw(kind, view(SIDE))), picture_bytes(kind, view(SIDE), COUNT))
    for encoding in ("rle", "png"):
        row = (peak(lambda: masks(view(SIDE), encoding)), masks_bytes([view(SIDE)], 1, COUNT))
        rows[f"{encoding} by {mode}"] = row
print(json.dumps(rows))
"""


def test_what_one_request_may_not_hold_is_refused_by_name(settings: Settings, models_dir: Path, post, finish) -> None:
    info = post()
    finish(info)
    small = CallSettings(request_memory_bytes=70 << 20)
    large = PosedCamera(Camera(2000, 2000, 2000.0, 2000.0, 1000.0, 1000.0), np.eye(4))
    changed = settings.model_copy(update={"calls": small, "models": models_dir})
    with open_service(changed) as service:
        with pytest.raises(LimitExceededError) as picture:
            service.answers.picture(PictureRequest(info.id, "rgb", camera=large))
        with pytest.raises(LimitExceededError) as masks:
            service.answers.query(QueryRequest(info.id, ("mug",), (large,), outputs=frozenset({"mask2d"})))
        for error in (picture.value, masks.value):
            assert "FASTSPLAT_CALLS__REQUEST_MEMORY_BYTES" in error.limit and "MiB" in error.limit
        assert (picture.value.field, masks.value.field) == ("camera", "cameras")
        assert service.answers.picture(PictureRequest(info.id, "rgb", view="front.jpg"))
        assert service._context.memory.reserved == 0
        neighbor = service.in_project("another")
        assert neighbor is service.in_project("another") and neighbor._context.memory is service._context.memory


def test_limits_that_are_not_set_follow_from_the_machine(service: SceneService) -> None:
    budget = MemoryBudget(CallSettings(), 1 << 30)
    with budget.reserve(1 << 28, "camera"), budget.reserve(1 << 28, "camera"):
        assert budget.reserved == 1 << 29
    with pytest.raises(LimitExceededError, match="257 MiB"), budget.reserve((1 << 28) + (1 << 20), "camera"):
        raise AssertionError


def test_requests_wait_until_others_have_released_enough() -> None:
    budget = MemoryBudget(CallSettings(answer_memory_bytes=100, request_memory_bytes=60), 0)
    begun, release, order = threading.Event(), threading.Event(), []

    def first() -> None:
        with budget.reserve(60, "camera"):
            begun.set()
            assert release.wait(60)
            order.append("first")

    def second() -> None:
        with budget.reserve(60, "camera"):
            order.append("second")

    threads = [threading.Thread(target=first), threading.Thread(target=second)]
    threads[0].start()
    assert begun.wait(60)
    with budget.reserve(40, "camera"):  # fits beside
        pass
    threads[1].start()
    release.set()
    for thread in threads:
        thread.join(60)
    assert order == ["first", "second"] and budget.reserved == 0


def test_who_waits_for_memory_leaves_when_nobody_waits_for_the_answer_and_needs_no_thread() -> None:
    budget = MemoryBudget(CallSettings(answer_memory_bytes=100, request_memory_bytes=100), 0)
    cancelled = Cancellation()
    cancelled.cancel()
    with budget.reserve(100, "camera"):
        with cancellable(cancelled), pytest.raises(CancelledError), budget.reserve(1, "camera"):
            raise AssertionError
        with run_by(object()), pytest.raises(CallAgainError), budget.reserve(1, "camera"):
            raise AssertionError
    assert budget.reserved == 0


def test_small_requests_do_not_overtake_a_large_one_that_waits() -> None:
    seconds = 0.0
    budget = MemoryBudget(CallSettings(answer_memory_bytes=100, request_memory_bytes=100), 0, lambda: seconds)
    large, small = object(), object()
    with budget.reserve(30, "camera"):
        with run_by(large), pytest.raises(CallAgainError), budget.reserve(80, "camera"):
            raise AssertionError
        with run_by(small), pytest.raises(CallAgainError), budget.reserve(20, "camera"):
            raise AssertionError  # there is room for it now
    with run_by(large), budget.reserve(80, "camera"), run_by(small), budget.reserve(20, "camera"):
        assert budget.reserved == 100
        with run_by(large), pytest.raises(CallAgainError), budget.reserve(80, "camera"):
            raise AssertionError
    seconds += 60.0  # whoever has left keeps nobody waiting
    with budget.reserve(100, "camera"):
        assert budget.reserved == 100


def test_edits_and_scenes_that_open_take_their_share_of_the_memory(
    settings: Settings, models_dir: Path, post, finish
) -> None:
    info = post()
    finish(info)
    recolor = [Edit("recolor", "mug", color=Color(1.0, 0.0, 0.0))]
    small = CallSettings(request_memory_bytes=1 << 20)
    with open_service(settings.model_copy(update={"calls": small, "models": models_dir})) as service:
        with pytest.raises(LimitExceededError) as edit:
            service.versions.edit(info.id, recolor)
        assert edit.value.field == "edits" and "REQUEST_MEMORY_BYTES" in edit.value.limit
        assert [version.version for version in service.versions.all(info.id)] == ["v1"]
    with open_service(
        settings.model_copy(update={"calls": CallSettings(answer_memory_bytes=1), "models": models_dir})
    ) as service:
        with pytest.raises(LimitExceededError) as opened:
            service.answers.query(QueryRequest(info.id, ("mug",)))
        assert opened.value.field == "scene" and "ANSWER_MEMORY_BYTES" in opened.value.limit
    with open_service(settings.model_copy(update={"models": models_dir})) as service:
        memory = service._context.memory
        with memory.opening(memory._all), run_by(object()):
            with pytest.raises(CallAgainError):  # without a thread
                service.answers.query(QueryRequest(info.id, ("mug",)))
            memory._waiting.clear()
        assert service.answers.query(QueryRequest(info.id, ("mug",))).answers
        with memory.opening(memory._all), run_by(object()), pytest.raises(CallAgainError):
            service.versions.edit(info.id, recolor)
        memory._waiting.clear()
        assert service.versions.edit(info.id, recolor).current and memory.reserved == 0


_EDIT_PEAKS = """
import gc, json, sys, tempfile
from pathlib import Path
import numpy as np
from fastsplat.service.application.base.memory import edit_bytes
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat_contract.geometry.poses import pose_of
from fastsplat_contract.messages.scenes import Edit
from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.splatting.torch_runtime import release_free_memory
from tests.scenes import labelled_scene

COUNT = 200_000
random = np.random.default_rng(0)
encoder = open_text_encoder(sys.argv[1], Path(sys.argv[2]))
scene = labelled_scene(
    random.uniform(-2, 2, (COUNT, 3)), np.arange(COUNT) % 2 + 1, ("mug", "banana"), scales=0.02,
    sh=np.zeros((COUNT, 4, 3)), encoder=encoder, templates=QuerySettings().templates,
)
shift = np.eye(4)
shift[0, 3] = 5.0
edits = {
    "recolor": [Edit("recolor", "mug", color=(1.0, 0.0, 0.0))],
    "move": [Edit("move", "mug", transform=pose_of(shift))],
    "remove": [Edit("remove", "mug")],
    "duplicate": [Edit("duplicate", "mug", transform=pose_of(shift))],
    "three": [Edit("recolor", "mug", color=(1.0, 0.0, 0.0)), Edit("move", "banana", transform=pose_of(shift)),
              Edit("recolor", "mug", color=(0.0, 1.0, 0.0))],
}
rows = {}
with tempfile.TemporaryDirectory() as folder:
    write_scene(scene, Path(folder) / "scene")
    for name, made in edits.items():
        index = SceneIndex(read_scene(Path(folder) / "scene"), encoder, QuerySettings())
        gc.collect()
        release_free_memory()  # what the edit before left in the allocator would hide what this one needs
        before = status("VmRSS")
        Path("/proc/self/clear_refs").write_text("5")
        for edit in made:
            index = index.after(apply_edit(index, edit))
        write_scene(index.scene, Path(folder) / name)
        write_ply(index.scene.gaussians, Path(folder) / f"{name}.ply")
        rows[name] = (status("VmHWM") - before, edit_bytes(scene, ()))
print(json.dumps(rows))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads the peak from /proc")
@pytest.mark.parametrize("program", [_PEAKS, _EDIT_PEAKS], ids=["pictures", "edits"])
def test_estimates_are_above_the_real_peak_and_not_far_above(models_dir: Path, program: str) -> None:
    command = [sys.executable, "-c", _STATUS + program, "minilm_l6_int8", str(models_dir)]
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True, cwd=Path(__file__).parents[2])
    for kind, (peak, estimate) in json.loads(done.stdout).items():
        assert peak <= estimate <= 4 * peak + (128 << 20), (kind, peak >> 20, estimate >> 20)


def test_what_is_kept_between_calls_is_counted_and_leaves_before_anybody_waits() -> None:
    budget, dropped = MemoryBudget(CallSettings(answer_memory_bytes=100, request_memory_bytes=100), 1), []
    assert budget.keep(60, lambda: dropped.append("first")) and budget.keep(30, lambda: dropped.append("second"))
    assert budget.cached_bytes == 90 and not budget.keep(11, lambda: dropped.append("never"))
    with budget.reserve(10, "camera"):
        assert dropped == [] and budget.cached_bytes == 90 and not budget.keep(1, lambda: dropped.append("never"))
        with budget.reserve(20, "camera"):
            assert dropped == ["first", "second"] and budget.cached_bytes == 0 and budget.reserved == 30
    assert budget.keep(100, lambda: dropped.append("third"))
    with budget.reserve(100, "camera"):
        assert dropped == ["first", "second", "third"]
