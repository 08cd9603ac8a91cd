"""Subscriptions of a robot that moves: `python -m benchmarks.subscriptions`.

One real `fastsplat api` process on loopback, and a worker that trains the sample capture beside it on the same cores.
Each question is a stream of its own, into which the robot's poses go at a steady rate; a pose has a moment at which it
is due, and its latency counts from there until its last answer is at the client, so that a pose that was sent late is
not measured as a fast one. Writes benchmarks/results/subscriptions.json.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.provenance import NOT_CHOSEN, begin, parser_of, write_results
from benchmarks.serve.api_process import Api
from benchmarks.serve.room_beside_training import served_room
from fastsplat_client import Client, QueryRequest, Subscription
from fastsplat_contract.geometry.camera import Camera, PosedCamera

_QUESTIONS = (("tea",), ("something to sit on", "submarine"), ("fork", "banana", "time"))
_CAMERA = Camera(width=320, height=240, fx=250.0, fy=250.0, cx=160.0, cy=120.0)
_STALL_S = 1.0
_WARM_S = 3.0


def main() -> None:
    """Measure, print and write."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="how long the robot moves")
    parser.add_argument("--rate", type=float, default=10.0, help="poses a second")
    parser.add_argument("--gaussians", type=int, default=20_000, help="of the scene that is asked")
    parser.add_argument("--no-training", action="store_true", help="without the training beside")
    options = parser.parse_args()
    start = begin()
    with served_room(options.gaussians, training=not options.no_training) as served:
        api, scene = served.api, served.scene
        _walk(api, scene, _WARM_S, options.rate)
        before = api.resident_mib()
        walks = _walk(api, scene, options.seconds, options.rate)
        after = api.resident_mib()
        trained = served.trains()
    row = {
        "training_throughout": trained,
        "picture": [_CAMERA.width, _CAMERA.height],
        "outputs": ["mask2d", "objects"],
        "stall_s": _STALL_S,
        **_figures(walks),
        "questions": [{"texts": walk.texts, **_figures([walk])} for walk in walks],
        "server_mib": {"start": before, "end": after, "growth": round(after / before - 1, 4)},
    }
    print(json.dumps(row, indent=1))
    write_results("subscriptions", start, options, NOT_CHOSEN, row)


@dataclass
class _Walk:
    """What one question's stream brought.

    Attributes:
        texts: of the question.
        sent: poses.
        latencies_s: of each answered pose, from the moment at which it was due.
        gaps_s: between two answers.
        dropped: poses that no answer came for.
        reconnected: new connections.
        late_s: the longest time that a pose was sent after it was due.
    """

    texts: tuple[str, ...]
    sent: int = 0
    latencies_s: list[float] = field(default_factory=list)
    gaps_s: list[float] = field(default_factory=list)
    dropped: int = 0
    reconnected: int = 0
    late_s: float = 0.0


def _walk(api: Api, scene: str, seconds: float, rate: float) -> list[_Walk]:
    """All questions at once, each on a thread of its own."""
    walks = [_Walk(texts) for texts in _QUESTIONS]
    errors: list[BaseException] = []

    def ask(walk: _Walk) -> None:
        try:
            _ask(api, scene, walk, round(seconds * rate), rate)
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=ask, args=(walk,)) for walk in walks]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        raise errors[0]
    return walks


def _ask(api: Api, scene: str, walk: _Walk, count: int, rate: float) -> None:
    start = time.monotonic() + 0.5

    def poses() -> Iterator[PosedCamera]:
        for number in range(count):
            due = start + number / rate
            time.sleep(max(0.0, due - time.monotonic()))
            walk.late_s = max(walk.late_s, time.monotonic() - due)
            walk.sent += 1
            yield _pose(number / rate)

    request = QueryRequest(scene, walk.texts, outputs=frozenset({"mask2d", "objects"}))
    target = f"127.0.0.1:{api.grpc_port}"
    last = start
    with Client(f"http://127.0.0.1:{api.http_port}", key=api.key, grpc_target=target) as client:
        for answer in client.stream_query(Subscription(request, heartbeat_s=1.0), poses()):
            now = time.monotonic()
            walk.latencies_s.append(now - start - (answer.sequence - 1) / rate)
            walk.gaps_s.append(now - last)
            walk.dropped += answer.dropped
            walk.reconnected += answer.reconnected
            last = now


def _pose(seconds: float) -> PosedCamera:
    """A robot that drives to and fro before the scene, and turns."""
    turn = 0.3 * np.sin(0.7 * seconds)
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    pose[:3, 3] = 0.8 * np.sin(0.31 * seconds), 0.1 * np.sin(1.3 * seconds), 0.5 * np.sin(0.17 * seconds)
    return PosedCamera(_CAMERA, pose)


def _figures(walks: list[_Walk]) -> dict[str, Any]:
    latencies = np.concatenate([walk.latencies_s for walk in walks]) * 1e3
    gaps = np.concatenate([walk.gaps_s for walk in walks])
    percentiles = {f"p{p}_ms": round(float(np.percentile(latencies, p)), 1) for p in (50, 95, 99)}
    return {
        "sent": sum(walk.sent for walk in walks),
        "answered": len(latencies),
        "dropped": sum(walk.dropped for walk in walks),
        **percentiles,
        "max_ms": round(float(latencies.max()), 1),
        "stalls": int((gaps > _STALL_S).sum()),
        "longest_gap_s": round(float(gaps.max()), 3),
        "reconnected": sum(walk.reconnected for walk in walks),
        "sent_late_ms": round(1e3 * max(walk.late_s for walk in walks), 1),
    }


if __name__ == "__main__":
    main()
