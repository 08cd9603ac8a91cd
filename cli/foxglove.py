"""`fastsplat foxglove`: a scene live in Foxglove."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from fastsplat.api.access.exposure import is_loopback
from fastsplat.cli.local_service import local_service
from fastsplat.cli.remote import Ca, KeyFile, Server, connect
from fastsplat.service.application.base.optional_packages import FOXGLOVE, needed
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat_contract.exports import ExportRequest

_POLL_S = 2.0


def foxglove(
    scene: Annotated[str, typer.Argument(help="The scene's id.")],
    port: Annotated[int, typer.Option(min=0, max=65535, help="To listen at; 0: a free one.")] = 8765,
    host: Annotated[
        str, typer.Option(help="Address to listen at. Whoever reaches it sees the scene: there are no keys.")
    ] = "127.0.0.1",
    camera_s: Annotated[float, typer.Option(min=0.05, help="Seconds between two of the scene's cameras.")] = 1.0,
    cell: Annotated[float, typer.Option(help="Distance between points, scene units.")] = 0.0,
    project: Annotated[str, typer.Option(help="The project whose scene it is.")] = "",
    server: Server = "",
    key_file: KeyFile = None,
    ca: Ca = None,
) -> None:
    """Show a scene live in Foxglove: boxes, labels, points, floor map, cameras. New versions are followed."""
    with needed(FOXGLOVE, "showing a scene in Foxglove", "scene", "on this machine"):
        from fastsplat.service.application.exporting.foxglove_live import LiveScene, follow
    stop = threading.Event()
    with _source(scene, cell, project, server, key_file, ca) as (version, file), _set_by_signals(stop):
        shown = version()
        with LiveScene(f"fastsplat {scene}", host, port, time.time_ns, file(shown)) as live:
            typer.echo(f"ws://{host}:{live.port}")
            typer.echo(live.app_url, err=True)
            if not is_loopback(host):
                typer.echo(f"Whoever reaches {host}:{live.port} sees the scene, without a key.", err=True)
            follow(live, shown, version, file, stop, camera_s=camera_s, poll_s=_POLL_S)


@contextmanager
def _source(
    scene: str, cell: float, project: str, server: str, key_file: Path | None, ca: Path | None
) -> Iterator[tuple[Callable[[], str], Callable[[str], bytes]]]:
    """What says the scene's current version, and what makes the file of one: of a server, or of this machine."""
    if server:
        with connect(server, key_file, ca, project) as client:
            yield (
                lambda: next(each.version for each in client.versions(scene) if each.current),
                lambda version: client.export(scene, "mcap", version=version, cell=cell),
            )
    else:
        with local_service(project or DEFAULT_PROJECT) as service:
            yield (
                lambda: service.versions.resolve(scene),
                lambda version: service.exports.file(ExportRequest(scene, "mcap", version, cell=cell)),
            )


@contextmanager
def _set_by_signals(stop: threading.Event) -> Iterator[None]:
    """SIGINT and SIGTERM set `stop`, on the main thread, which alone gets signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: stop.set()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
