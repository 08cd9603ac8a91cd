"""`fastsplat scenes foxglove`: a scene live in Foxglove."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

from fastsplat.api.access.exposure import is_loopback
from fastsplat.cli.options import SceneId, service_command
from fastsplat.cli.scene_commands import scenes_app
from fastsplat.cli.session import Session
from fastsplat.service.application.base.optional_packages import FOXGLOVE, needed

_POLL_S = 2.0


@service_command(scenes_app, json=False)
def foxglove(
    session: Session,
    scene: SceneId,
    port: Annotated[int, typer.Option(min=0, max=65535, help="To listen at; 0: a free one.")] = 8765,
    host: Annotated[
        str, typer.Option(help="Address to listen at. Whoever reaches it sees the scene: there are no keys.")
    ] = "127.0.0.1",
    camera_s: Annotated[float, typer.Option(min=0.05, help="Seconds between two of the scene's cameras.")] = 1.0,
    cell: Annotated[float, typer.Option(help="Distance between points, scene units.")] = 0.0,
) -> None:
    """Show a scene live in Foxglove: boxes, labels, points, floor map, cameras. New versions are followed."""
    with needed(FOXGLOVE, "showing a scene in Foxglove", "scene", "on this machine"):
        from fastsplat.service.application.exporting.foxglove_live import LiveScene, follow
    scene_id = session.scene(scene)

    def current() -> str:
        return session.current(scene_id)

    def file(version: str) -> bytes:
        return session.client.export(scene_id, "mcap", version=version, cell=cell)

    stop = threading.Event()
    with _set_by_signals(stop):
        shown = current()
        with LiveScene(f"fastsplat {scene_id}", host, port, time.time_ns, file(shown)) as live:
            typer.echo(f"ws://{host}:{live.port}")
            typer.echo(live.app_url, err=True)
            if not is_loopback(host):
                typer.echo(f"Whoever reaches {host}:{live.port} sees the scene, without a key.", err=True)
            follow(live, shown, current, file, stop, camera_s=camera_s, poll_s=_POLL_S)


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
