"""A machine that misbehaves: a server stopped in an upload, two servers, a read-only disk, clocks that jump."""

from __future__ import annotations

import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from fastsplat.service.store.records import NewJob
from fastsplat.service.store.store import open_store
from tests.workers.deployment import _PICTURES, Deployment

_READ_ONLY = """
import sys
from pathlib import Path
from fastsplat.service.application.service import open_service
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import FastSplatError
settings = Settings(data_dir=Path(sys.argv[1]))
def ended(call):
    try:
        call()
        return "answered"
    except FastSplatError as error:
        return error.reason
service = None
def start():
    global service
    service = open_service(settings)
print(ended(start))
if service is not None:
    for call in (service.list_scenes, lambda: service.get_scene("scene"), lambda: service.new_upload(),
                 lambda: service.resumable.create("k", "a.zip", 10), lambda: service.delete_scene("scene"),
                 lambda: service.cancel_operation("op"), service.admin.check_ready):
        print(ended(call))
"""


def _form(number: int) -> bytes:
    parts = [f'--b\r\nContent-Disposition: form-data; name="request_id"\r\n\r\nr{number}\r\n'.encode()]
    for index, picture in enumerate(_PICTURES):
        head = f'--b\r\nContent-Disposition: form-data; name="images"; filename="{index}.png"\r\n\r\n'
        parts += [head.encode(), picture, b"\r\n"]
    return b"".join([*parts, b"--b--\r\n"])


def test_a_server_that_is_told_to_stop_in_an_upload_leaves_nothing_and_takes_it_again(tmp_path: Path) -> None:
    deployment = Deployment(tmp_path, "")
    try:
        api = deployment.start_api()
        port = int(deployment.http.rsplit(":", 1)[1])
        body = _form(0)
        head = (
            f"POST /v1/scenes HTTP/1.1\r\nHost: localhost:{port}\r\nContent-Length: {len(body)}\r\n"
            "Content-Type: multipart/form-data; boundary=b\r\n\r\n"
        )
        with socket.create_connection(("127.0.0.1", port), timeout=60) as half:
            half.sendall(head.encode() + body[: len(body) // 2])
            deployment.wait_for(lambda: deployment.left_over())
            api.send_signal(signal.SIGTERM)
            assert api.wait(timeout=90) is not None
        assert deployment.service.list_scenes()[0] == ()
        before = deployment.left_over()
        deployment.start_api()
        reply = httpx.post(
            f"{deployment.http}/v1/scenes",
            content=body,
            headers={"Content-Type": "multipart/form-data; boundary=b"},
            timeout=60,
        )
        assert reply.status_code == 202, reply.text
        assert before == [] and len(deployment.left_over()) == 1
    finally:
        deployment.close()


def test_of_two_servers_on_one_folder_each_sees_what_the_other_took_and_one_request_id_makes_one_job(
    tmp_path: Path,
) -> None:
    first = Deployment(tmp_path, "")
    second = Deployment(tmp_path, "")
    try:
        for deployment in (first, second):
            deployment.start_api()
        made = first.post_over_http(request_id="once")
        assert second.post_over_http(request_id="once") == made
        assert httpx.get(f"{second.http}/v1/operations/{made}", timeout=60).json()["state"] == "QUEUED"
        cancelled = httpx.post(f"{second.http}/v1/operations/{made}:cancel", timeout=60).json()
        assert cancelled["state"] == "CANCELLED"
        assert httpx.get(f"{first.http}/v1/operations/{made}", timeout=60).json()["state"] == "CANCELLED"
    finally:
        first.close()
        second.close()


def test_on_a_read_only_disk_every_call_ends_in_an_answer_or_a_typed_error(tmp_path: Path) -> None:
    data = tmp_path / "data"
    store = open_store(data)
    store.scenes.create(NewJob("scene", "op", "desk", "", "d", "up", {}))
    store.close()
    mount = f'mount --bind {data} {data} && mount -o remount,ro,bind {data} && exec {sys.executable} -c "$1" {data}'
    command = ["unshare", "--mount", "--map-root-user", "sh", "-c", mount, "sh"]
    if shutil.which("unshare") is None or subprocess.run([*command, ""], check=False, capture_output=True).returncode:
        pytest.skip("no disk can be mounted here")
    done = subprocess.run([*command, _READ_ONLY], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    reasons = done.stdout.split()
    assert reasons and all(re.fullmatch(r"answered|[A-Z_]+", reason) for reason in reasons)
    assert reasons[0] != "answered" or reasons[3:] == [
        *("OUT_OF_RESOURCES", "OUT_OF_RESOURCES", "DATABASE_UNAVAILABLE", "DATABASE_UNAVAILABLE", "OUT_OF_RESOURCES")
    ]


@pytest.mark.parametrize("jump_s", [-86_400.0, 86_400.0])
def test_a_clock_that_jumps_costs_no_job_and_no_upload(deployment: Deployment, jump_s: float) -> None:
    """The worker's own clock jumps while it runs a job: its heartbeats, its cleanup and its rows follow."""
    running, waiting = deployment.post("training:sleep_once 3"), deployment.post()
    code = f"""
import threading, time
real, began = time.time, time.monotonic()
time.time = lambda: real() + ({jump_s} if time.monotonic() - began > 2.0 else 0.0)
"""
    worker = deployment.start_worker(code=code)
    deployment.wait_in("training", running)
    for operation in (running, waiting):
        assert deployment.wait_over(operation).state == "SUCCEEDED"
    assert worker.poll() is None
    deployment.wait_for(lambda: deployment.left_over() == [])
