"""How the service carries load: `python -m benchmarks.serve`.

One real `fastsplat api` process on loopback, clients in another process; every phase is bounded in time and count, and
every judgement is a ratio within this run or a difference of medians measured in turns. Writes
benchmarks/results/serve.json.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from statistics import median
from typing import Any

import grpc

from benchmarks.provenance import MADE_FAST_HERE, begin, parser_of, write_results
from benchmarks.serve.api_process import Api, load_of
from benchmarks.serve.load import Load
from benchmarks.serve.stored_scenes import add_scene, room
from fastsplat.service.application.service import open_service
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import open_store
from fastsplat_client.stream import SceneServiceStub
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.v1 import fastsplat_pb2 as pb

_TEXTS = ("tea", "fork", "something to sit on", "banana", "submarine", "time")


def main() -> None:
    """Run every phase, print the table, write the file."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="length of each loaded phase")
    parser.add_argument("--soak", type=float, default=90.0, help="length of the mixed-request phase")
    arguments = parser.parse_args()
    start = begin()
    models = Path(os.environ.get("FASTSPLAT_MODELS", ".models")).resolve()
    folder = Path(tempfile.mkdtemp(prefix="fastsplat-serve-"))
    rows: list[dict[str, Any]] = []

    def note(name: str, goal: str, reached: bool, **figures: object) -> None:
        rows.append({"phase": name, "goal": goal, "reached": reached, **figures})
        print(f"{'ok  ' if reached else 'MISS'} {name}: {goal}: {json.dumps(figures)}", flush=True)

    try:
        settings = Settings(data_dir=folder / "data", models=models)
        store = open_store(settings.data_dir, settings.database_url)
        small = room(20_000, models)
        scene = add_scene(store, small)
        with Api(settings, {}) as api:
            _overhead(settings, scene, api, note)
            _crowd(scene, api, arguments.seconds, note)
            _soak(scene, api, arguments.soak, note)
        few = {"FASTSPLAT_LIMITS__ADMITTED": "16", "FASTSPLAT_LIMITS__IN_FLIGHT": "1000"}
        with Api(settings, few) as api:
            _flood(scene, api, arguments.seconds, note)
        _shelf(settings, small, note)
        big = add_scene(store, room(1_000_000, models))
        _cold(settings, big, note)
        store.close()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    write_results("serve", start, arguments, MADE_FAST_HERE, {"rows": rows})


Note = Callable[..., None]


def _paths(scene: str) -> tuple[str, ...]:
    return tuple(f"/query?scene={scene}&text={text.replace(' ', '%20')}" for text in _TEXTS)


def _overhead(settings: Settings, scene: str, api: Api, note: Note) -> None:
    """The same warm question in process, over REST and over gRPC, in turns."""
    times: Mapping[str, list[float]] = {"in_process": [], "rest": [], "grpc": []}
    service = open_service(settings)
    metadata = (("authorization", f"Bearer {api.key}"),)
    with grpc.insecure_channel(f"127.0.0.1:{api.grpc_port}") as channel, api.http() as http, service:
        stub = SceneServiceStub(channel)
        ways: dict[str, Callable[[str], object]] = {
            "in_process": lambda text: service.answers.query(QueryRequest(scene, (text,))),
            "rest": lambda text: http.get("/query", params={"text": text, "scene": scene}).raise_for_status(),
            "grpc": lambda text: list(stub.Query(pb.QueryRequest(scene_id=scene, texts=[text]), metadata=metadata)),
        }
        for turn in range(320):
            for name, ask in ways.items():
                begun = time.perf_counter()
                ask(_TEXTS[turn % len(_TEXTS)])
                if turn >= 20:
                    times[name].append((time.perf_counter() - begun) * 1e3)
    p50 = {name: round(median(values), 3) for name, values in times.items()}
    for name, goal in (("rest", 3.0), ("grpc", 1.5)):
        over = round(p50[name] - p50["in_process"], 3)
        note(f"overhead of {name}", f"at most {goal} ms at p50", over <= goal, overhead_ms=over, p50_ms=p50)


def _crowd(scene: str, api: Api, seconds: float, note: Note) -> None:
    load_of(Load((api.http_port,), _paths(scene), api.key, 50, 2.0))
    got = load_of(Load((api.http_port,), _paths(scene), api.key, 50, seconds))
    ratio = round(got["p99_ms"] / got["p50_ms"], 2)
    fine = set(got["statuses"]) == {"200"} and ratio <= 5
    note("50 clients", "no error, p99 at most 5 times p50", fine, p99_over_p50=ratio, **got)


def _flood(scene: str, api: Api, seconds: float, note: Note) -> None:
    load_of(Load((api.http_port,), _paths(scene), api.key, 16, 2.0))
    calm = load_of(Load((api.http_port,), _paths(scene), api.key, 16, seconds, probe="/livez"))
    flood = load_of(Load((api.http_port,), _paths(scene), api.key, 160, seconds, probe="/livez"))
    ratio = round(flood["p99_ms"] / calm["p99_ms"], 2)
    fine = ratio <= 2 and set(flood["statuses"]) <= {"200", "429", "503", "probe 200"}
    note(
        "ten times the admitted load", "the admitted keep p99 within 2 times", fine, ratio=ratio, calm=calm, flood=flood
    )
    worst = flood["probe"]["max_ms"]
    note("/livez in the flood", "answers within 50 ms", worst <= 50, max_ms=worst)


def _soak(scene: str, api: Api, seconds: float, note: Note) -> None:
    """Rankings, pictures, lists and refusals for a while, after a warm-up of the same kind."""
    pictures = tuple(
        f"/v1/scenes/{scene}/{kind}.png?view={view}.jpg&text=tea" for kind in ("overlay", "rgb") for view in range(4)
    )
    mixed = (*_paths(scene) * 6, *pictures, "/v1/scenes", f"/v1/scenes/{scene}", "/query?text=", "/v1/scenes/none")
    load_of(Load((api.http_port,), mixed, api.key, 8, min(30.0, seconds)))
    before = api.resident_mib()
    got = load_of(Load((api.http_port,), mixed, api.key, 8, seconds))
    after = api.resident_mib()
    growth = round(after / before - 1, 4)
    figures = {"before_mib": before, "after_mib": after, "requests": sum(got["statuses"].values())}
    note("mixed requests", "resident memory grows by at most 2 %", growth <= 0.02, growth=growth, **figures, **got)


def _shelf(settings: Settings, small: Any, note: Note) -> None:
    """One client's p50 on a scene that stands alone and on one among a thousand others; fresh processes, in turns."""
    shelves = {}
    for name, other_count in (("alone", 0), ("among_1000", 1_000)):
        shelf_settings = settings.model_copy(update={"data_dir": settings.data_dir.parent / name})
        store = open_store(shelf_settings.data_dir, shelf_settings.database_url)
        scene = add_scene(store, small)
        for _ in range(other_count):
            add_scene(store, small, like=scene)
        store.close()
        shelves[name] = (shelf_settings, scene)
    times: dict[str, list[float]] = {name: [] for name in shelves}
    for _ in range(4):
        for name, (shelf_settings, scene) in shelves.items():
            with Api(shelf_settings, {}) as api:
                load_of(Load((api.http_port,), _paths(scene), api.key, 1, 30.0, requests=200))
                got = load_of(Load((api.http_port,), _paths(scene), api.key, 1, 30.0, requests=1500))
                times[name].append(float(got["p50_ms"]))
    change = round(median(times["among_1000"]) / median(times["alone"]) - 1, 3)
    note("1,000 stored scenes", "/query?scene= changes by under 10 %", change < 0.1, change=change, p50_ms=times)


def _cold(settings: Settings, scene: str, note: Note) -> None:
    """The first answer of a scene that no process has open; the text encoder was used once before."""
    times = []
    for _ in range(3):
        with Api(settings, {}) as api, api.http() as http:
            http.get("/query", params={"text": "tea", "scene": "none"})
            begun = time.perf_counter()
            http.get("/query", params={"text": "tea", "scene": scene}).raise_for_status()
            times.append(round(time.perf_counter() - begun, 3))
    note("a cold scene of 1M Gaussians", "first answer within 1 s", median(times) <= 1, seconds=times)


if __name__ == "__main__":
    main()
