"""Forks commands and Python sessions from a process that has done their imports and nothing else."""

from __future__ import annotations

import gc
import json
import os
import signal
import socket
import subprocess
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

_ROOT = Path(__file__).parents[2]
_STREAMS = [0, 1, 2]
_COMMAND = """#!{python} -IS
import json, os, socket, sys

with socket.socket(socket.AF_UNIX) as server:
    server.connect({address!r})
    socket.send_fds(server, [b"+"], [0, 1, 2])
    order = {{"arguments": sys.argv[1:], "folder": os.getcwd(), "environment": dict(os.environ)}}
    server.sendall(json.dumps(order).encode() + b"\\n")
    status = server.recv(1)
sys.exit(status[0] if status else "the process that runs commands has ended")
"""


@contextmanager
def forks(folder: Path) -> Iterator[Path]:
    """The process while the block runs. Yields a folder for the path, whose `fastsplat` is run by it."""
    address, programs = folder / "forks", folder / "programs"
    programs.mkdir()
    (programs / "fastsplat").write_text(_COMMAND.format(python=sys.executable, address=str(address)))
    (programs / "fastsplat").chmod(0o755)
    environment = {**os.environ, "PYTHONPATH": str(_ROOT)}
    command = [sys.executable, "-m", "tests.docs.forks", str(address)]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, start_new_session=True)
    try:
        assert process.stdout is not None and process.stdout.readline(), "the imports failed"
        yield programs
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


class PythonSession:
    """Python that keeps what is defined in it, in a process of its own."""

    def __init__(self, programs: Path, folder: Path, environment: dict[str, str], sink: BinaryIO) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(str(programs.with_name("forks")))
        with open(os.devnull, "rb") as nothing:
            socket.send_fds(self._socket, [b"+"], [nothing.fileno(), sink.fileno(), sink.fileno()])
        self._stream = self._socket.makefile("rwb")
        self._send({"arguments": None, "folder": str(folder), "environment": environment})

    def run(self, code: str, where: str, environment: dict[str, str], patience_s: float) -> str:
        """Run code, after these environment variables were set; returns the traceback, "" if there is none."""
        self._socket.settimeout(patience_s)
        self._send({"code": code, "where": where, "environment": environment})
        line = self._stream.readline()
        return str(json.loads(line)) if line else "the session has ended"

    def close(self) -> None:
        self._stream.close()
        self._socket.close()

    def _send(self, order: dict[str, Any]) -> None:
        self._stream.write(json.dumps(order).encode() + b"\n")
        self._stream.flush()


def _serve(address: str) -> None:
    """Fork for each connection until killed."""
    import torch  # noqa: F401  commands that measure or draw load it late

    import fastsplat.api.rest.app
    import fastsplat.cli.main
    import fastsplat.service.library.sample
    import fastsplat_client  # noqa: F401

    gc.freeze()  # otherwise the end of each fork would copy and free what all share
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody asks how a connection has ended
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(address)
        listener.listen(16)
        print("ready", flush=True)
        while True:
            connection, _ = listener.accept()
            if os.fork() == 0:
                listener.close()
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                break
            connection.close()
    _, streams, *_ = socket.recv_fds(connection, 1, len(_STREAMS))
    stream = connection.makefile("rwb")
    order = json.loads(stream.readline())
    child = os.fork()
    if child:
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        if order["arguments"] is not None:
            connection.send(bytes([code if code >= 0 else 128 - code]))
        os._exit(0)
    for ours, theirs in zip(_STREAMS, streams, strict=True):
        os.dup2(theirs, ours)
    os.chdir(order["folder"])
    os.environ.clear()
    os.environ.update(order["environment"])
    if order["arguments"] is None:
        _converse(stream)
    else:
        stream.close()
        sys.argv = ["fastsplat", *order["arguments"]]
        fastsplat.cli.main.main()


def _converse(stream: Any) -> None:
    names: dict[str, Any] = {"__name__": "__main__"}
    for line in stream:
        order = json.loads(line)
        os.environ.update(order["environment"])
        failure = ""
        try:
            exec(compile(order["code"], order["where"], "exec"), names)
        except BaseException:
            failure = traceback.format_exc()
        sys.stdout.flush()
        stream.write(json.dumps(failure).encode() + b"\n")
        stream.flush()


if __name__ == "__main__":
    _serve(sys.argv[1])
