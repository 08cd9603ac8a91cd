"""Examples of keys, projects, server status and known names."""

from __future__ import annotations

from datetime import UTC, datetime

from fastsplat.api.examples.change_examples import Bodies
from fastsplat.api.examples.example_parameters import IDS, PAGE_TOKEN
from fastsplat_contract.jobs.name_suggestions import AgreeIn, CaptionerStatus
from fastsplat_contract.messages.known_names import KnownName, KnownNameList
from fastsplat_contract.messages.projects import CreateProjectRequest, JobLog, Project, ProjectList
from fastsplat_contract.server.keys import AccessKey, KeyIn, KeyList, NewKey, UploadKeyIn
from fastsplat_contract.server.server_info import ServerInfo
from fastsplat_contract.server.server_status import (
    DiskHealth,
    ModelStatus,
    QueueHealth,
    QuotaStatus,
    ServerHealth,
    ServerStatus,
    WorkerHealth,
)

_CREATED_AT = datetime(2026, 1, 1, 12, 0, tzinfo=UTC)

KEY = AccessKey(
    id=IDS["key_id"],
    name="robot in the kitchen",
    project="default",
    role="reader",
    state="VALID",
    created_at=_CREATED_AT,
    expires_at=datetime(2027, 1, 1, 12, 0, tzinfo=UTC),
    revoked_at=None,
)
NEW_KEY = NewKey(KEY, f"fsk_{KEY.id}_is-43-letters-digits-hyphens-or-underscores")
KEYS = KeyList((KEY,), PAGE_TOKEN)
_MUG_NAME = KnownName(IDS["name_id"], "mug", IDS["scene_id"], IDS["version"], 1, _CREATED_AT, b"\xff\xd8\xff")
KNOWN_NAMES = KnownNameList((_MUG_NAME,), PAGE_TOKEN)
CAPTIONER = CaptionerStatus("localhost:11434", "model-of-your-choice", agreed=True)
AGREEMENTS: Bodies = {
    "yes": ("pictures of objects without a name may go there", AgreeIn("localhost:11434")),
    "no": ("nothing is sent any more", AgreeIn("")),
}
STATUS = ServerStatus(
    version="0.1.0",
    project="default",
    role="operator",
    key_expires_at=None,
    asks_for_keys=True,
    upload_operation="",
    models=(
        ModelStatus("text_encoder", "minilm_l6_int8", "ready", calibrated=True),
        ModelStatus("open_set_detector", "", "unset", calibrated=None),
    ),
    backend="cpu",
    training_backend="cuda",
    workers=2,
    quotas=(QuotaStatus("scenes", 12, 1_000), QuotaStatus("bytes", 3_000_000_000, None), QuotaStatus("jobs", 1, 100)),
    max_upload_bytes=10_000_000_000,
    max_images=2_000,
    addresses=("http://192.168.1.20:8000/",),
    captioner=CAPTIONER,
    health=ServerHealth(
        workers=(WorkerHealth("b2f1c0", 4_217, 1.5, alive=True), WorkerHealth("b2f1c0", 4_218, 1.9, alive=True)),
        queue=QueueHealth(waiting=3, running=2, waits_s=340.0),
        disk=DiskHealth(500_000_000_000, 62_000_000_000, 1_073_741_824),
    ),
)

NEW_KEYS: Bodies = {
    "robot": ("a key for a year that only looks", KeyIn("robot in the kitchen", "reader", 31_536_000.0)),
    "person": ("a key that also creates and changes", KeyIn("Ada")),
}
UPLOAD_KEYS: Bodies = {"default": ("a link for one's phone", UploadKeyIn())}
PROJECT = Project("kitchen", _CREATED_AT, scenes=3, keys=2)
PROJECT_LIST = ProjectList((PROJECT,))
JOB_LOG = JobLog("loading 60 images\n")
SERVER = ServerInfo("0.1.0", ":8001")
PROJECTS: Bodies = {"kitchen": ("one for the kitchen", CreateProjectRequest("kitchen"))}
