"""How often a job may be started: only starts that brought it no further than those before count against it."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import pytest

from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.settings import JobSettings, Settings
from fastsplat.service.store.blobs.file_digests import write_digests
from fastsplat.service.store.rows.records import NewJob
from fastsplat.service.store.store import Store, open_store
from fastsplat.workers.engine import supervisor as supervising
from fastsplat.workers.engine.supervisor import ReturnedError, Supervisor
from fastsplat.workers.kinds.job_kinds import KINDS

_JOBS = JobSettings(progress_interval_s=1e-6, max_starts=3)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    store = open_store(tmp_path / "data")
    store.scenes.create(NewJob("scene", "job", "", "", "", "upload", {"labels": [], "validated": ""}))
    yield store
    store.close()


class _WorkerDiedError(Exception):
    """The worker dies with its trainer, and says nothing any more."""


class _Trainer:
    """In place of a trainer process: reports fractions of the training, then ends with an error."""

    pid = 0

    def __init__(self, fractions: Sequence[float], error: type[Exception]) -> None:
        self._fractions, self._error = iter(fractions), error

    def next(self, timeout: float) -> ProgressEvent:
        for fraction in self._fractions:
            return ProgressEvent("training", fraction, "at work")
        raise self._error

    def status(self) -> str:
        return "it was killed"

    def kill(self) -> None:
        """Nothing is left of it."""


@pytest.mark.parametrize("error", [EOFError, _WorkerDiedError])
@pytest.mark.parametrize(
    ("reached", "starts"),
    [
        ([0.5] * 20, 3),  # after the first it comes no further
        ([0.0] * 20, 3),
        ([0.05 * step for step in range(1, 11)], 10),  # each comes further: it may be started as often as it takes
        ([0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.4, 0.4], 8),
        ([0.1, 0.2, 0.3, *[0.3] * 9], 5),  # the third start that got to .3, and no further
        ([0.5, 0.1, 0.2, 0.3, 0.4], 3),  # further than the last, but not than the first
        ([0.5, 0.503, 0.506, 0.507], 3),  # so little may be the time between two reports
    ],
)
def test_a_start_counts_only_where_the_job_came_no_further_since_the_one_before(
    store: Store,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    reached: Sequence[float],
    starts: int,
    error: type[Exception],
) -> None:
    """Each attempt reaches the fraction of its number, step by step, and dies, until the job is given up."""
    left = list(reached)

    def start(*_: object, **__: object) -> _Trainer:
        furthest = left.pop(0)
        return _Trainer([furthest * part / 8 for part in range(9)], error)

    settings = Settings(data_dir=tmp_path / "data", jobs=_JOBS)
    monkeypatch.setattr(supervising, "TrainerProcess", start)
    while left:
        claim = store.jobs.claim("job")
        worker = Supervisor(store, settings, claim, KINDS["create_scene"], threading.Event())
        if worker.start_limit_error() is not None:
            break
        with suppress(ReturnedError, _WorkerDiedError):
            outcome = worker.run_stage("training")
            assert outcome.error is not None and outcome.error["reason"] == "TRAINER_CRASHED"
            break
    assert len(reached) - len(left) == starts


def test_a_job_whose_result_was_published_before_its_worker_died_needs_no_trainer(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though its work folder may be on a machine that this one does not see."""
    for _ in range(2):
        claim = store.jobs.claim("job")
    result = tmp_path / "export"
    result.mkdir()
    summary = {
        "gaussians": 3,
        "objects": 0,
        "scale": "ARBITRARY",
        "dictionary": [],
        "cameras": [],
        "quality": {"stage_seconds": {}},
    }
    (result / "summary.json").write_text(json.dumps(summary))
    (result / "stage.json").write_text(json.dumps({"seconds": 1.5}))
    write_digests(result)
    store.blobs.publish(result, "scene", claim.operation.run_id)
    monkeypatch.setattr(supervising, "TrainerProcess", lambda *_: pytest.fail("a trainer"))
    settings = Settings(data_dir=tmp_path / "data", jobs=_JOBS)
    assert Supervisor(store, settings, claim, KINDS["create_scene"], threading.Event()).run().state == "done"
    scene = store.scenes.scene("scene")
    assert (scene.state, scene.gaussians, scene.quality["stage_seconds"]) == ("READY", 3, {"export": 1.5})
