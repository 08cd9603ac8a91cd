"""What a second and a third API server add: `python -m benchmarks.serve.servers`.

One, two and three real `fastsplat api` processes, each with a data folder of its own, share a PostgreSQL server and an
S3 server (moto), which are processes, too. One scene is open on all. A fixed number of clients, divided among the
servers, ask for a ranking, then for a ranking with a 2D mask of a stored view. As all of it shares the processors of
this machine, questions a second say little about several machines; the seconds of processors that a question takes of
each part do. Writes benchmarks/results/servers.json.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import fsspec
import httpx

from benchmarks.provenance import NOT_CHOSEN, RESULTS, begin, parser_of, write_results
from benchmarks.serve.api_process import Api, load_of
from benchmarks.serve.load import Load
from benchmarks.serve.stored_scenes import add_scene, room
from benchmarks.workers.database_seconds import cpu_seconds, process_seconds
from fastsplat.service.settings import Settings
from fastsplat.service.store.artefact_settings import ArtefactSettings
from fastsplat.service.store.store import open_store
from release.check_wheels import free_ports
from tests.postgres import PostgresServer
from tests.waiting import wait_for

_MOST_SERVERS = 3
_WARM_S = 2.0
_TEXTS = ("tea", "fork", "something%20to%20sit%20on", "banana", "submarine", "time")
_QUESTIONS = {
    "ranking": "/query?scene={scene}&text={text}",
    "mask": "/query?scene={scene}&text={text}&outputs=mask2d&view={view}.jpg",
}
_KEY = {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret", "AWS_DEFAULT_REGION": "us-east-1"}


def main() -> None:
    """Measures, prints and writes."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=12.0, help="of each of the six measurements")
    parser.add_argument("--clients", type=int, default=12, help="with one question under way each")
    parser.add_argument("--gaussians", type=int, default=20_000, help="of the scene")
    options = parser.parse_args()
    start = begin()
    os.environ.update(_KEY)
    with (
        tempfile.TemporaryDirectory(prefix="fastsplat-servers-", ignore_cleanup_errors=True) as folder,
        closing(PostgresServer()) as database,
        database.database() as url,
        _bucket() as (store, artefacts),
    ):
        rows = list(_rows(Path(folder), database, url, store, artefacts, options))
    write_results("servers", start, options, NOT_CHOSEN, {"cores": os.cpu_count(), "rows": rows})
    print(RESULTS / "servers.json")


def _rows(
    folder: Path,
    database: PostgresServer,
    url: str,
    store: subprocess.Popen[bytes],
    artefacts: ArtefactSettings,
    options: Any,
) -> Iterator[dict[str, Any]]:
    """A row for each number of servers and each kind of question."""
    models = Path(os.environ.get("FASTSPLAT_MODELS", ".models")).resolve()
    with closing(open_store(folder / "apart", url, artefacts)) as apart:
        scene = add_scene(apart, room(options.gaussians, models))
    shared = {
        "FASTSPLAT_DATABASE_URL": url,
        "FASTSPLAT_ARTEFACTS__URL": artefacts.url,
        "FASTSPLAT_ARTEFACTS__ENDPOINT_URL": artefacts.endpoint_url,
    }
    with ExitStack() as opened:
        servers: list[Api] = []
        for number in range(_MOST_SERVERS):
            settings = Settings(data_dir=folder / str(number) / "data", models=models)
            settings.data_dir.mkdir(parents=True, mode=0o700)
            if servers:  # the first one has made the first key
                settings.first_key.write_text(servers[0].key)
            servers.append(opened.enter_context(Api(settings, shared)))
            for name, path in _QUESTIONS.items():
                paths = tuple(path.format(scene=scene, text=text, view=view) for text in _TEXTS for view in range(4))
                with servers[-1].http() as http:  # nothing is opened or cached during a measurement
                    for address in paths:
                        http.get(address).raise_for_status()
                ports = tuple(server.http_port for server in servers)
                load_of(Load(ports, paths, servers[0].key, options.clients, _WARM_S))
                before = _seconds(servers, database, store)
                got = load_of(Load(ports, paths, servers[0].key, options.clients, options.seconds))
                used = {part: after - before[part] for part, after in _seconds(servers, database, store).items()}
                row = {"servers": len(servers), "question": name, **got, **_figures(got, used)}
                print(row, flush=True)
                yield row


def _seconds(servers: Sequence[Api], database: PostgresServer, store: subprocess.Popen[bytes]) -> dict[str, float]:
    """Seconds of processors that each part took so far; loads are children that have ended."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "servers": sum(process_seconds(server.pid) for server in servers),
        "database": cpu_seconds(database),
        "store": process_seconds(store.pid),
        "clients": ended.ru_utime + ended.ru_stime,
    }


def _figures(got: dict[str, Any], used: dict[str, float]) -> dict[str, Any]:
    count = got["count"]
    return {
        "questions_a_second": round(count / got["seconds"], 1),
        "cpu_ms": {part: round(1e3 * seconds / count, 3) for part, seconds in used.items()},
        "cores": {part: round(seconds / got["seconds"], 3) for part, seconds in used.items()},
    }


@contextmanager
def _bucket() -> Iterator[tuple[subprocess.Popen[bytes], ArtefactSettings]]:
    """An S3 server in a process of its own, and a bucket in it."""
    (port,) = free_ports(1)
    command = [sys.executable, "-m", "moto.server", "--host", "127.0.0.1", "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    endpoint = f"http://127.0.0.1:{port}"
    try:
        wait_for(lambda: _answers(endpoint))
        fsspec.filesystem("s3", endpoint_url=endpoint, skip_instance_cache=True).mkdir("scenes")
        yield process, ArtefactSettings(url="s3://scenes/place", endpoint_url=endpoint)
    finally:
        process.kill()
        process.wait()


def _answers(url: str) -> bool:
    try:
        return httpx.get(url, timeout=5).is_success
    except httpx.TransportError:
        return False


if __name__ == "__main__":
    main()
