"""Many clients at once, in a process of its own: `python -m benchmarks.serve.load` reads a JSON job from stdin.

Plain asyncio streams with keep-alive: on two cores a heavy HTTP client would measure itself.
"""

from __future__ import annotations

import asyncio
import json
import random
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass

_MOST_REQUESTS = 1_000_000


@dataclass(frozen=True)
class Load:
    """What to send.

    Attributes:
        ports: of servers on loopback, which clients are divided among.
        paths: GET targets; each client walks through them, starting at one of its own.
        key: API key.
        clients: connections, each with one request under way.
        seconds: bound on the time.
        requests: bound on the number, all clients together; 0 for none.
        probe: a path that one more client asks for ten times a second, timed apart; "" for none.
    """

    ports: tuple[int, ...]
    paths: tuple[str, ...]
    key: str
    clients: int
    seconds: float
    requests: int = 0
    probe: str = ""


async def run(load: Load) -> dict[str, object]:
    """Latencies in ms of the answers with status 200, counts by status, latencies of the probe."""
    deadline = time.monotonic() + load.seconds
    left = load.requests or _MOST_REQUESTS
    latencies: list[float] = []
    statuses: Counter[str] = Counter()
    probes: list[float] = []

    async def client(number: int) -> None:
        nonlocal left
        turn = random.Random(number)
        connection = _Connection(load.ports[number % len(load.ports)], load.key)
        await asyncio.sleep(turn.uniform(0, 0.2))  # not all in the same instant
        while left > 0 and time.monotonic() < deadline:
            left -= 1
            path = load.paths[(number + left) % len(load.paths)]
            begun = time.perf_counter()
            status, wait_s = await connection.get(path)
            statuses[status] += 1
            if status == "200":
                latencies.append((time.perf_counter() - begun) * 1e3)
            elif status in ("429", "503"):
                await asyncio.sleep(max(wait_s, 0.05) * turn.uniform(1.0, 1.5))
            elif status == "error":
                await asyncio.sleep(0.05)
        connection.close()

    async def prober() -> None:
        connection = _Connection(load.ports[0], "")
        while time.monotonic() < deadline:
            begun = time.perf_counter()
            status, _ = await connection.get(load.probe)
            statuses[f"probe {status}"] += 1
            probes.append((time.perf_counter() - begun) * 1e3)
            await asyncio.sleep(0.1)
        connection.close()

    began = time.monotonic()
    tasks = [client(number) for number in range(load.clients)] + ([prober()] if load.probe else [])
    await asyncio.gather(*tasks)
    return {
        "seconds": round(time.monotonic() - began, 2),
        "statuses": dict(statuses),
        **_percentiles(latencies),
        **({"probe": _percentiles(probes)} if probes else {}),
    }


class _Connection:
    """One kept-alive HTTP/1.1 connection."""

    def __init__(self, port: int, key: str) -> None:
        self._port = port
        self._key = key
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def get(self, path: str) -> tuple[str, float]:
        """The status ("error" if the connection broke) and Retry-After in seconds."""
        try:
            if self._streams is None:
                self._streams = await asyncio.open_connection("127.0.0.1", self._port)
            reader, writer = self._streams
            authorization = f"Authorization: Bearer {self._key}\r\n" if self._key else ""
            writer.write(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n{authorization}\r\n".encode())
            head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").lower()
            headers = dict(line.split(": ", 1) for line in head.split("\r\n")[1:] if ": " in line)
            await reader.readexactly(int(headers.get("content-length", "0")))
            return head.split(" ", 2)[1], float(headers.get("retry-after", "0"))
        except (OSError, EOFError):
            self.close()
            return "error", 0.0

    def close(self) -> None:
        if self._streams is not None:
            self._streams[1].close()
            self._streams = None


def _percentiles(latencies: list[float]) -> dict[str, float]:
    if not latencies:
        return {"count": 0}
    ordered = sorted(latencies)

    def at(share: float) -> float:
        return round(ordered[min(len(ordered) - 1, int(share * len(ordered)))], 3)

    return {"count": len(ordered), "p50_ms": at(0.5), "p90_ms": at(0.9), "p99_ms": at(0.99), "max_ms": at(1.0)}


def as_job(load: Load) -> bytes:
    """The JSON that this module reads from stdin."""
    return json.dumps(asdict(load)).encode()


if __name__ == "__main__":
    print(json.dumps(asyncio.run(run(Load(**json.loads(sys.stdin.read()))))))
