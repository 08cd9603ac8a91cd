"""A real API that serves a drawn room, with a real worker that trains beside it on the same cores."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.serve.api_process import Api
from benchmarks.serve.stored_scenes import add_scene, room
from benchmarks.serve.training_beside import training_beside
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import open_store


@dataclass(frozen=True)
class ServedRoom:
    """What is measured: `scene` is the room's id, `trains` says whether the training beside still runs."""

    api: Api
    settings: Settings
    scene: str
    trains: Callable[[], bool]


@contextmanager
def served_room(gaussians: int, *, training: bool) -> Iterator[ServedRoom]:
    """The room in a folder of its own, which is gone afterwards; models are those of FASTSPLAT_MODELS.

    Args:
        gaussians: of the room.
        training: whether a worker trains beside.

    Raises:
        RuntimeError: the training ended before its first step.
    """
    models = Path(os.environ.get("FASTSPLAT_MODELS", ".models")).resolve()
    with tempfile.TemporaryDirectory(prefix="fastsplat-bench-", ignore_cleanup_errors=True) as folder:
        settings = Settings(data_dir=Path(folder) / "data", models=models)
        store = open_store(settings.data_dir, settings.database_url)
        scene = add_scene(store, room(gaussians, models))
        store.close()
        with Api(settings, {}) as api, training_beside(api, settings, wanted=training) as trains:
            yield ServedRoom(api, settings, scene, trains)
