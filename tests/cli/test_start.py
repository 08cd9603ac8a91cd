"""A service that starts: its data is its owner's alone, its log is JSON without passwords, each device has a worker."""

from __future__ import annotations

import json
import logging
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from fastsplat.cli.operating.logs import JsonLines, PlainLines
from fastsplat.cli.operating.serve import worker_roles
from fastsplat_contract.errors import InvalidInputError

_START = """
import sys
from pathlib import Path
import fastsplat.service.capture.untrusted.confinement as confinement
confinement.missing_protections = lambda: tuple(sys.argv[2:])
from fastsplat.cli.main import _start
from fastsplat.service.store.store import open_store
_start("api")
store = open_store(Path(sys.argv[1]))
store.blobs.upload("one").mkdir(parents=True)
(store.blobs.upload("one") / "photo.jpg").write_bytes(b"home")
"""


@pytest.mark.parametrize("missing", [(), ("Landlock (files): not there", "seccomp (system calls): forbidden")])
def test_nobody_else_reads_the_data_and_the_log_says_what_is_missing(tmp_path: Path, missing: tuple[str, ...]) -> None:
    data = tmp_path / "data"
    started = subprocess.run(
        [sys.executable, "-c", _START, str(data), *missing], check=True, capture_output=True, text=True
    )
    messages = [json.loads(line)["message"] for line in started.stderr.splitlines()]
    assert [line for line in messages if "without protection" in line] == [
        f"parsers of uploads run without protection: {name}" for name in missing
    ]
    paths = [data, *data.rglob("*")]
    assert len(paths) > 3 and not any(path.stat().st_mode & 0o077 for path in paths)


def line(message: str, *values: object, **extra: object) -> dict[str, object]:
    record = logging.LogRecord("room", logging.WARNING, __file__, 1, message, values, None)
    vars(record).update(extra)
    text = JsonLines("worker").format(record)
    assert "\n" not in text
    parsed: dict[str, object] = json.loads(text)
    return parsed


def test_a_record_is_one_object_with_its_extras():
    parsed = line("two\nlines of %s", "text", operation="op1")
    assert parsed["message"] == "two\nlines of text" and parsed["operation"] == "op1"
    assert (parsed["level"], parsed["role"], parsed["logger"]) == ("WARNING", "worker", "room")


def test_a_trace_is_kept():
    try:
        raise ValueError("no")
    except ValueError:
        record = logging.LogRecord("room", logging.ERROR, __file__, 1, "bad", (), sys.exc_info())
    assert "ValueError: no" in json.loads(JsonLines("api").format(record))["trace"]


@pytest.mark.parametrize("formatter", [JsonLines, PlainLines])
@pytest.mark.parametrize(
    ("secret", "masked"),
    [
        ("fsk_0123456789ab_" + "aB-_" * 10 + "xyz", "fsk_0123456789ab_***"),
        ("postgresql+psycopg://user:secret@host:5432/db", "postgresql+psycopg://user:***@host:5432/db"),
    ],
)
def test_access_keys_and_passwords_are_not_told(formatter, secret, masked):
    record = logging.LogRecord("room", logging.WARNING, __file__, 1, "opened by %s", (secret,), None)
    record.header, record.deep = f"Bearer {secret}", {"a": [secret]}
    text = formatter("api").format(record)
    assert f"opened by {masked}" in text and secret not in text and "\n" not in text


def test_a_terminal_gets_plain_lines():
    terminal, stderr = pty.openpty()
    program = "import logging; from fastsplat.cli.operating.logs import log_to_stderr; log_to_stderr('api'); "
    program += "logging.info('ready'); logging.warning('full')"
    subprocess.run([sys.executable, "-c", program], stderr=stderr, check=True)
    os.close(stderr)
    lines = os.read(terminal, 1000).decode().splitlines()
    os.close(terminal)
    assert [line.split(maxsplit=1)[1] for line in lines] == ["api    ready", "api    WARNING: full"]


_CPUS = len(os.sched_getaffinity(0))


def test_each_device_has_a_worker_that_sees_no_other():
    roles = worker_roles("0,3,GPU-1a2b", 1, 0)
    assert {name: role.environment["CUDA_VISIBLE_DEVICES"] for name, role in roles.items()} == {
        "worker-0": "0",
        "worker-3": "3",
        "worker-GPU-1a2b": "GPU-1a2b",
    }


def test_workers_without_a_gpu_share_the_cpus():
    roles = worker_roles("cpu", 2, 0)
    assert list(roles) == ["worker-cpu-1", "worker-cpu-2"]
    for role in roles.values():
        assert role.environment == {
            "CUDA_VISIBLE_DEVICES": "",
            "FASTSPLAT_JOBS__THREADS_PER_JOB": str(max(1, _CPUS // 2)),
        }


def test_one_worker_needs_no_environment_and_a_setting_of_threads_stays():
    assert [role.environment for role in worker_roles("", 1, 0).values()] == [{}]
    assert [role.environment for role in worker_roles("", 3, 5).values()] == [{}] * 3


@pytest.mark.parametrize(("devices", "workers"), [("0,0", 1), ("tpu", 1), ("0;rm", 1), ("0,", 1), ("cpu", 0)])
def test_nonsense_is_refused(devices, workers):
    with pytest.raises(InvalidInputError) as caught:
        worker_roles(devices, workers, 0)
    assert caught.value.field in ("devices", "workers")
