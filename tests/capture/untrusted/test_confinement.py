"""A confined process, attacking: it reads, reaches and uses nothing beyond what it was lent."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from fastsplat.service.capture.untrusted.confinement import missing_protections

_CONFINED = """
import errno, os, socket, sys, threading
from pathlib import Path
from fastsplat.service.capture.untrusted.confinement import ResourceLimits, confine
lent = Path(sys.argv[1])
limits = ResourceLimits(memory_bytes=2 << 30, cpu_seconds=2, file_bytes=1 << 20, open_files=32)
print(confine(limits, [lent / "read"], [lent / "write"]))
def refused(attempt):
    try:
        attempt()
    except OSError as error:
        return errno.errorcode[error.errno]
    return "allowed"
"""


def _attack(folder: Path, code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process that may read `folder`/read and change `folder`/write."""
    for name in ("read", "write"):
        (folder / name).mkdir(exist_ok=True)
    return subprocess.run(
        [sys.executable, "-P", "-c", _CONFINED + code, str(folder)],
        check=False,
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
    )


def _needs(protection: str) -> None:
    missing = [line for line in missing_protections() if line.startswith(protection)]
    if missing:
        pytest.skip(f"not allowed here: {missing[0]}")


def _lines(process: subprocess.CompletedProcess[str]) -> list[str]:
    assert process.returncode == 0, process.stderr
    return process.stdout.splitlines()[1:]


def test_what_is_missing_is_what_a_confined_process_says(tmp_path: Path) -> None:
    process = _attack(tmp_path, "")
    assert process.returncode == 0, process.stderr
    assert process.stdout.strip() == str(missing_protections())


def test_it_reads_and_changes_nothing_but_what_it_was_lent(tmp_path: Path) -> None:
    _needs("Landlock")
    (tmp_path / "read").mkdir()
    (tmp_path / "read" / "a").write_text("lent")
    (tmp_path / "secret").write_text("another's")
    code = """
print((lent / "read" / "a").read_text())
print(refused(lambda: (lent / "secret").read_text()))
print(refused(lambda: list(lent.iterdir())))
print(refused(lambda: (lent / "read" / "b").write_text("x")))
print(refused(lambda: (lent / "new").write_text("x")))
print(refused(lambda: (lent / "read" / "a").rename(lent / "write" / "a")))
print(refused(lambda: os.symlink(lent / "secret", lent / "write" / "link") or (lent / "write" / "link").read_text()))
(lent / "write" / "b").write_text("x")
(lent / "write" / "b").rename(lent / "write" / "c")
"""
    attempts = _lines(_attack(tmp_path, code))
    assert attempts[0] == "lent" and set(attempts[1:]) <= {"EACCES", "EXDEV"} and len(attempts) == 7
    assert (tmp_path / "write" / "c").read_text() == "x" and (tmp_path / "read" / "a").exists()


def test_it_cannot_read_the_environment_of_the_process_that_started_it(tmp_path: Path) -> None:
    _needs("Landlock")
    code = """
print(refused(lambda: Path(f"/proc/{os.getppid()}/environ").read_bytes()))
print(refused(lambda: Path("/proc/self/environ").read_bytes()))
"""
    assert _lines(_attack(tmp_path, code)) == ["EACCES", "allowed"]


def test_it_reaches_no_server_of_its_own_machine(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        code = f"""
print(refused(lambda: socket.create_connection(("127.0.0.1", {port}), timeout=5)))
print(refused(lambda: socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)))
print(refused(lambda: socket.socketpair()))
"""
        _needs("seccomp")
        assert _lines(_attack(tmp_path, code)) == ["EPERM", "EPERM", "allowed"]


def test_its_files_descriptors_and_memory_are_bounded(tmp_path: Path) -> None:
    code = """
print(refused(lambda: (lent / "write" / "large").write_bytes(bytes(2 << 20))))
print(refused(lambda: [os.open("/dev/null", os.O_RDONLY) for _ in range(64)]))
try:
    bytes(3 << 30)
except MemoryError:
    print("no memory")
import resource
print(refused(lambda: None) if resource.getrlimit(resource.RLIMIT_AS)[1] == 2 << 30 else "unbounded")
"""
    assert _lines(_attack(tmp_path, code)) == ["EFBIG", "EMFILE", "no memory", "allowed"]


def test_a_process_that_computes_for_ever_is_ended(tmp_path: Path) -> None:
    process = _attack(tmp_path, "while True: pass\n")
    assert process.returncode == -signal.SIGXCPU


def test_a_user_who_is_not_root_starts_no_more_tasks_than_it_may() -> None:
    if os.getuid() != 0:
        pytest.skip("only root can run a process as somebody else")
    code = """
import os, resource, sys, threading
from fastsplat.service.capture.untrusted.confinement import ResourceLimits, confine
os.setgroups([]), os.setgid(65533), os.setuid(65533)
confine(ResourceLimits(2 << 30, 20, 1 << 20, processes=6), (), ())
stop, started = threading.Event(), 0
try:
    for _ in range(60):
        threading.Thread(target=stop.wait).start()
        started += 1
except RuntimeError:
    pass
try:
    child = os.fork()
    if not child:
        os._exit(0)
except OSError as error:
    child = error.strerror
stop.set()
print(started, child)
"""
    process = subprocess.run([sys.executable, "-P", "-c", code], check=False, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    started, refusal = process.stdout.strip().split(" ", 1)
    assert 1 <= int(started) <= 6
    assert refusal == os.strerror(11)
