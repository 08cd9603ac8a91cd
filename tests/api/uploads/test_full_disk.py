"""Every call that writes meets a disk that is full to the last byte: a typed refusal, and nothing is half written."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import pytest

from fastsplat.api.errors import refusal_of
from tests.processes import printed_with_mount

_CALLS = """
import json, sys
from contextlib import suppress
from pathlib import Path
from fastsplat.api.errors import refusal_of
from fastsplat.service.application.service import open_service
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.settings import Settings, UploadSettings
from fastsplat_contract.server.keys import KeyIn
from fastsplat_contract.jobs.look_again import LookAgainIn
from fastsplat_contract.jobs.operations import SceneOptions
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3
from fastsplat_contract.messages.scenes import Color, Edit, SceneUpdate
from tests.api.made_scene import ENCODER, add_scene, write_words

disk, models = Path(sys.argv[1]), Path(sys.argv[2])
write_words(models)
settings = Settings(
    data_dir=disk / "data", models=models, uploads=UploadSettings(min_free_bytes=0),
    perception=PerceptionSettings(text_encoder=ENCODER, open_set_detector="grounding_dino_tiny"),
)
service = open_service(settings)
scene = add_scene(service, settings)
service.versions.edit(scene, [Edit("recolor", "mug", color=Color(0.0, 1.0, 0.0))])
trained = service.versions.all(scene)[0].version


def stored():
    files = sorted(str(path.relative_to(disk)) for name in ("scenes", "uploads")
                   for path in (disk / "data" / name).rglob("*"))
    return files, [known.version for known in service.versions.all(scene)]


def upload():
    with service.new_upload() as session:
        session.write("a.jpg", [bytes(1 << 16)])
        service.create_scene(session, "new", "", SceneOptions())


def edit(*words, **more):
    return lambda: service.versions.edit(scene, [Edit(*words, **more)])


motion = Pose(Vector3(1.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
calls = {
    "recolor": edit("recolor", "mug", color=Color(1.0, 0.0, 0.0)), "remove": edit("remove", "mug"),
    "move": edit("move", "mug", transform=motion), "duplicate": edit("duplicate", "mug", transform=motion),
    "upload": upload, "resumable": lambda: service.resumable.create("default", "a.zip", 1 << 20),
    "undo": lambda: service.versions.undo(scene), "redo": lambda: service.versions.redo(scene),
    "restore": lambda: service.versions.restore(scene, trained),
    "rename": lambda: service.update_scene(scene, SceneUpdate("n" * 200)),
    "key": lambda: service.keys.create("operator", KeyIn("k" * 190, "reader")),
    "look again": lambda: service.look_again(scene, LookAgainIn(("cup",))),
}
with suppress(OSError), open(disk / "other", "wb", buffering=0) as other:
    while other.write(bytes(1 << 16)):
        pass
with suppress(OSError), open(disk / "rest", "wb", buffering=0) as rest:
    while rest.write(bytes(1)):
        pass
reasons, changed = {}, []
for name, call in calls.items():
    before = stored()
    try:
        call()
        reasons[name] = "answered"
    except Exception as error:
        refusal = refusal_of(error, "r")
        reasons[name] = refusal.reason
        if stored() != before:
            changed.append(name)
print(json.dumps([reasons, changed, service.get_scene(scene).state]))
"""


def test_each_writing_call_on_a_full_disk_is_refused_by_name_and_changes_nothing(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    printed = printed_with_mount(f"mount -t tmpfs -o size=48m tmpfs {disk}", _CALLS, disk, tmp_path / "models")
    reasons, changed, state = json.loads(printed.splitlines()[-1])
    assert reasons.pop("redo") in ("answered", "CONFLICT", "DATABASE_UNAVAILABLE")  # where there was no undo
    assert set(reasons.values()) <= {"answered", "OUT_OF_RESOURCES", "DATABASE_UNAVAILABLE"}, reasons
    of_files = ("recolor", "remove", "move", "duplicate", "upload", "resumable")
    assert reasons["upload"] == "OUT_OF_RESOURCES" and "answered" not in {reasons[name] for name in of_files}
    assert changed == [] and state == "READY"


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_is_a_resource_that_the_server_is_out_of(number: int) -> None:
    refusal = refusal_of(OSError(number, "no room", "/data/scenes/5f"), "r")
    assert (refusal.reason, refusal.status.http) == ("OUT_OF_RESOURCES", 503)
    assert refusal.details["hint"] and "/data" not in str(refusal.as_problem())
    assert refusal_of(OSError(errno.EIO, "broken"), "r").reason == "INTERNAL"
