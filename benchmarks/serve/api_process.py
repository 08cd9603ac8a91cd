"""A real `fastsplat api` process, and clients in another."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Self

import httpx

from benchmarks.serve.load import Load, as_job
from fastsplat.service.settings import Settings
from release.check_wheels import free_ports

_START_S = 60.0


class Api:
    """The API alone, on free loopback ports, ready once entered."""

    def __init__(self, settings: Settings, environment: Mapping[str, str]) -> None:
        self._settings = settings
        self.http_port, self.grpc_port, metrics_port = free_ports(3)
        self._environment = {
            **os.environ,
            "FASTSPLAT_DATA_DIR": str(settings.data_dir),
            "FASTSPLAT_MODELS": str(settings.models),
            "FASTSPLAT_AUTH": settings.auth,
            "FASTSPLAT_HTTP_PORT": str(self.http_port),
            "FASTSPLAT_GRPC_PORT": str(self.grpc_port),
            "FASTSPLAT_METRICS_PORT": str(metrics_port),
            "FASTSPLAT_LIMITS__RATE_PER_S": "100000",
            "FASTSPLAT_LIMITS__BURST": "1000000",
            **environment,
        }

    def __enter__(self) -> Self:
        log = open(self._settings.data_dir.parent / "api.log", "ab")
        command = [sys.executable, "-m", "fastsplat.cli.main", "api"]
        self._process = subprocess.Popen(command, env=self._environment, stdout=log, stderr=log)
        log.close()
        deadline = time.monotonic() + _START_S
        while True:
            try:
                if httpx.get(f"http://127.0.0.1:{self.http_port}/readyz", timeout=5).status_code == 200:
                    break
            except httpx.HTTPError:
                pass
            if self._process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError("the API did not start")
            time.sleep(0.1)
        self.key = self._settings.first_key.read_text().strip() if self._settings.auth == "on" else ""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._process.terminate()
        self._process.wait(60)

    def http(self) -> httpx.Client:
        """A client with the key."""
        return httpx.Client(
            base_url=f"http://127.0.0.1:{self.http_port}", headers={"Authorization": f"Bearer {self.key}"}, timeout=60
        )

    @property
    def pid(self) -> int:
        """Id of the process."""
        return self._process.pid

    def resident_mib(self) -> float:
        """Resident memory of the process."""
        with open(f"/proc/{self._process.pid}/status") as status:
            kib = next(int(line.split()[1]) for line in status if line.startswith("VmRSS"))
        return round(kib / 1024, 1)


def load_of(load: Load) -> dict[str, Any]:
    """Run a load in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.serve.load"], input=as_job(load), stdout=subprocess.PIPE, check=True
    )
    result: dict[str, Any] = json.loads(done.stdout)
    return result
