"""Small files that a running job publishes through progress events.

The supervisor makes them visible to the API and lists them in the operation's row; they are deleted with the work
folder. Names include the attempt, and no file is written twice.
"""

from __future__ import annotations

import itertools
import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

from fastsplat.service.capture.sfm.placed_cameras import PlacedViews, placed_to_json
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.splatting.training.previews import TrainingPreview
from fastsplat.workers.job.protocol import Job
from fastsplat_contract.jobs.job_watching import Provisional

_LOOK_EVERY_S = 0.5


class ProgressFiles:
    """Publishes a stage's progress files; errors of `progress` end the stage."""

    def __init__(self, job: Job, stage: str, progress: Progress) -> None:
        self._job, self._progress = job, progress
        self._last = ProgressEvent(stage, 0.0, "")
        self._numbers = itertools.count(1)

    def progress(self, event: ProgressEvent) -> None:
        """Forwards an event; files are announced with its figures."""
        self._last = event
        self._progress(event)

    def preview(self, preview: TrainingPreview) -> None:
        info = {name: value for name, value in asdict(preview).items() if name != "jpeg"}
        self._publish("preview", ".jpg", preview.jpeg, info)

    def placed(self, placed: PlacedViews) -> None:
        info = {"placed": placed.placed, "images": placed.images, "complete": placed.complete}
        self._publish("placed", ".json", placed_to_json(placed), info)

    def draft(self, name: str, provisional: Provisional) -> None:
        """Announces a folder of the work folder's `drafts`."""
        self._announce("draft", name, provisional._asdict())

    def _publish(self, kind: str, ending: str, content: bytes, info: Mapping[str, Any]) -> None:
        name = f"{kind}-{self._job.attempt}-{next(self._numbers)}{ending}"
        folder = self._job.folder / "progress"
        unfinished = folder / f".{name}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            unfinished.write_bytes(content)  # not fsynced: replaced soon anyway
            os.replace(unfinished, folder / name)
        except OSError as error:  # not worth failing the job
            print(f"{name} is not shown: {error}", file=sys.stderr, flush=True)
            return
        self._announce(kind, name, info)

    def _announce(self, kind: str, name: str, info: Mapping[str, Any]) -> None:
        last = self._last
        self._progress(ProgressEvent(last.stage, last.fraction, last.message, {}, {kind: {"file": name, "info": info}}))


def finish_requested(job: Job) -> Callable[[], bool]:
    """Returns a function that polls, at most twice a second, for early finish requests."""
    looked_at, requested = -_LOOK_EVERY_S, False

    def look() -> bool:
        nonlocal looked_at, requested
        now = time.monotonic()
        if not requested and now - looked_at >= _LOOK_EVERY_S:
            looked_at, requested = now, job.finish_mark.exists()
        return requested

    return look
