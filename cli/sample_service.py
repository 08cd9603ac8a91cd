"""The REST interface in this process, without a port: for commands that speak by the client and need no server."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fastsplat.api.rest.app import create_app
from fastsplat.api.rest.in_process import InProcess, running_loop
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import open_service
from fastsplat.service.library.local_scene import folder_settings


@contextmanager
def in_process(folder: Path) -> Iterator[InProcess]:
    """What carries a client's requests to a service over a data folder, without keys, while the block runs."""
    own = {"auth": "off", "host": "127.0.0.1", "cors_origins": (), "root_path": ""}
    settings = folder_settings(folder).model_copy(update=own)
    with open_service(settings) as service, running_loop() as loop:
        threads = Threads(settings.limits, uploads=settings.uploads)
        transport = InProcess(create_app(service, settings, threads), loop, ("127.0.0.1", 0))
        try:
            yield transport
        finally:
            transport.stop()
            threads.close()
