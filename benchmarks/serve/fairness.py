"""What one key's load costs another: `python -m benchmarks.serve.fairness`, writes benchmarks/results/fairness.json.

A real API and a real worker that trains the sample capture beside it, on the same cores. The quiet key asks one
question after the other and looks at one picture in twelve; the loud key holds ten times as many requests open, each of
them dear (a picture of 4 Mpx, or masks in 16 views). Measured in turns, so that both phases see the same training: the
quiet key's latencies without the loud one, and with it.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import numpy as np

from benchmarks.provenance import MADE_FAST_HERE, begin, parser_of, write_results
from benchmarks.serve.api_process import Api, load_of
from benchmarks.serve.load import Load
from benchmarks.serve.room_beside_training import served_room
from fastsplat.service.settings import Settings
from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.json_codec import to_plain

_GOAL = 1.5
_TURNS = 3
_VIEWS = 16
_LOUD_SIDE = 2048
_TEXTS = ("tea", "fork", "something%20to%20sit%20on", "banana", "submarine", "time")


def main() -> None:
    """Measure, print and write."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="length of each turn of each phase")
    parser.add_argument("--loud", type=int, default=10, help="requests that the loud key holds open")
    parser.add_argument("--no-training", action="store_true", help="without the training beside")
    options = parser.parse_args()
    start = begin()
    with served_room(20_000, training=not options.no_training) as served:
        quiet, loud = _key(served.settings, "quiet"), _key(served.settings, "loud")
        figures = _measure(served.api, served.scene, quiet, loud, options.seconds, options.loud)
    row = {"training": not options.no_training, "loud_requests": options.loud, **figures}
    print(json.dumps(row, indent=1))
    write_results("fairness", start, options, MADE_FAST_HERE, row)


def _measure(api: Api, scene: str, quiet: str, loud: str, seconds: float, count: int) -> dict[str, Any]:
    paths = [f"/query?scene={scene}&text={text}" for text in _TEXTS] * 2
    paths[5] = f"/v1/scenes/{scene}/overlay.png?view=0.jpg&text=tea"
    load_of(Load(api.http_port, tuple(paths), quiet, 1, 5.0))
    rows: dict[str, list[dict[str, Any]]] = {"alone": [], "beside": []}
    outcomes: Counter[str] = Counter()
    for _ in range(_TURNS):
        rows["alone"].append(load_of(Load(api.http_port, tuple(paths), quiet, 1, seconds)))
        with _loud(api, scene, loud, count, outcomes):
            rows["beside"].append(load_of(Load(api.http_port, tuple(paths), quiet, 1, seconds)))
    figures: dict[str, Any] = {name: _summary(turns) for name, turns in rows.items()}
    ratio = round(figures["beside"]["p99_ms"] / figures["alone"]["p99_ms"], 2)
    return {"p99_ratio": ratio, "goal": _GOAL, "reached": ratio <= _GOAL, **figures, "loud": dict(outcomes)}


def _summary(turns: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians over the turns; counts by status of all."""
    statuses: Counter[str] = Counter()
    for turn in turns:
        statuses.update(turn["statuses"])
    names = ("p50_ms", "p90_ms", "p99_ms", "max_ms")
    return {**{name: float(np.median([turn[name] for turn in turns])) for name in names}, "statuses": dict(statuses)}


@contextmanager
def _loud(api: Api, scene: str, key: str, count: int, outcomes: Counter[str]) -> Iterator[None]:
    """`count` connections that send one dear request after the other."""
    stop = threading.Event()
    views = [to_plain(_camera(number)) for number in range(_VIEWS)]
    masks = {"texts": ["tea", "fork"], "outputs": ["mask2d"], "cameras": views}
    picture = {"kind": "rgb", "camera": to_plain(_camera(0))}

    def client(number: int) -> None:
        with httpx.Client(
            base_url=f"http://127.0.0.1:{api.http_port}", headers={"Authorization": f"Bearer {key}"}, timeout=20
        ) as http:
            while not stop.is_set():
                call, body = ((":query", masks), (":render", picture))[number % 2]
                try:
                    answer = http.post(f"/v1/scenes/{scene}{call}", json=body)
                    outcomes[str(answer.status_code)] += 1
                    if answer.status_code in (429, 503):
                        stop.wait(0.05)
                except httpx.HTTPError as error:
                    outcomes[type(error).__name__] += 1

    threads = [threading.Thread(target=client, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    time.sleep(1.0)
    try:
        yield
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def _camera(number: int) -> PosedCamera:
    pose = np.eye(4)
    pose[0, 3] = 0.02 * number
    side = _LOUD_SIDE
    return PosedCamera(Camera(side, side, 0.8 * side, 0.8 * side, side / 2, side / 2), pose, "")


def _key(settings: Settings, name: str) -> str:
    """A new key, by the command that people use."""
    environment = {**os.environ, "FASTSPLAT_DATA_DIR": str(settings.data_dir)}
    command = [sys.executable, "-m", "fastsplat.cli.main", "keys", "create", name]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    match = re.search(r"fsk_\w+_[\w-]+", done.stdout)
    assert match is not None
    return match.group()


if __name__ == "__main__":
    main()
