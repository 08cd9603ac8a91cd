"""The calls of `version_machine` on two server processes, for as long as one likes; prints how many there were.

    python -m tests.application.versions_at_length [calls on each database, 5000 by default] [sqlite] [postgresql]

On SQLite the servers share a data folder, on PostgreSQL a database and an object store. Jobs end in this process.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from fastsplat.service.common.process import die_with_parent
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.store.settings import ArtefactSettings
from fastsplat.service.store.store import open_store
from fastsplat_client import Client
from fastsplat_contract.errors import FastSplatError
from fastsplat_contract.scenes import Edit, SceneVersion
from tests.api.made_scene import ENCODER, write_words
from tests.application.version_machine import LIMIT, Place, run
from tests.postgres import PostgresServer

_SCENES, _STEPS = 4, 25


@dataclass(frozen=True)
class _Remote:
    """A `Server` over HTTP."""

    client: Client

    def edit(self, scene_id: str, edits: Sequence[Edit], request_id: str) -> SceneVersion:
        return self.client.edit_scene(scene_id, edits, request_id=request_id)

    def undo(self, scene_id: str, version: str) -> SceneVersion:
        return self.client.undo_edit(scene_id, version)

    def redo(self, scene_id: str, version: str) -> SceneVersion:
        return self.client.redo_edit(scene_id, version)

    def restore(self, scene_id: str, version: str, expected: str) -> SceneVersion:
        return self.client.restore_version(scene_id, version, expected=expected)

    def all(self, scene_id: str) -> tuple[SceneVersion, ...]:
        return self.client.versions(scene_id)


@contextmanager
def _server(data: Path, models: Path, database_url: str, objects: str, log: Path) -> Iterator[_Remote]:
    """One `fastsplat api`, once it answers."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    settings = {
        "DATA_DIR": data, "MODELS": models, "DATABASE_URL": database_url, "ARTEFACTS__URL": objects, "AUTH": "off",
        "HTTP_PORT": port, "GRPC_PORT": 0, "METRICS_PORT": 0, "QUERY__BACKEND": "reference",
        "CALLS__MAX_VERSIONS": LIMIT,
    }  # fmt: skip
    environment = {**os.environ, **{f"FASTSPLAT_{name}": str(value) for name, value in settings.items()}}
    parent = os.getpid()
    with log.open("wb") as output:
        process = subprocess.Popen(
            ["fastsplat", "api"], env=environment, stdout=output, stderr=output,
            preexec_fn=lambda: die_with_parent(parent),
        )  # fmt: skip
    with Client(f"http://127.0.0.1:{port}", timeout_s=120) as client:
        while True:
            try:
                list(client.scenes())
                break
            except FastSplatError:
                assert process.poll() is None, log.read_text()
                time.sleep(0.2)
        yield _Remote(client)
    assert process.poll() is None, log.read_text()
    process.terminate()
    process.wait()


def at_length(database_url: str, calls: int) -> None:
    """Make calls until there were at least so many.

    Raises:
        AssertionError: something acknowledged is not there, or a state is not the one that it has to be.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write_words(folder / "models")
        objects = folder / "objects" if database_url else None
        url = "" if objects is None else objects.as_uri()
        folders = [folder / "data", folder / ("data" if objects is None else "elsewhere")]
        stores = [open_store(data, database_url, ArtefactSettings(url=url)) for data in folders]
        servers = [
            stack.enter_context(_server(data, folder / "models", database_url, url, folder / f"log{number}"))
            for number, data in enumerate(folders)
        ]
        encoder = open_text_encoder(ENCODER, folder / "models")
        place = Place(
            (servers[0], servers[1]), (stores[0], stores[1]), objects or folders[0], encoder, objects is not None
        )
        began, database = time.monotonic(), "PostgreSQL" if database_url else "SQLite"
        while place.calls < calls:
            run(place, _SCENES, _STEPS)
            print(f"{database}: {place.calls} calls on {place.scenes} scenes, {dict(place.answers)}", end=" ")
            print(f"{time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    _calls = int(sys.argv[1]) if len(sys.argv) > 1 else 5000
    _databases = sys.argv[2:] or ["sqlite", "postgresql"]
    if "sqlite" in _databases:
        at_length("", _calls)
    if "postgresql" in _databases:
        _postgres = PostgresServer()
        with _postgres.database() as _url:
            at_length(_url, _calls)
        _postgres.close()
