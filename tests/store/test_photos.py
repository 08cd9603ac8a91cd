"""Verdicts of photos: written by the worker that has the job, gone with the scene."""

from __future__ import annotations

import json

import pytest

from fastsplat.service.settings import CallSettings
from fastsplat.service.store.queue.claims import FencedError
from fastsplat.service.store.store import Store
from fastsplat.workers.job.claimed_job import ClaimedJob
from fastsplat.workers.job.results import PHOTOS
from tests.scenes import claimed_job

_PHOTOS = [{"name": "a.jpg", "placed": True}, {"name": "<b>.jpg", "placed": False}]


def _claimed(store: Store) -> ClaimedJob:
    return ClaimedJob(store, claimed_job(store), CallSettings())


def _write(job: ClaimedJob, photos: object) -> None:
    (job.folder / "capture").mkdir(parents=True, exist_ok=True)
    (job.folder / "capture" / PHOTOS).write_text(json.dumps(photos))


def test_a_worker_writes_them_once_its_capture_stage_has(store: Store) -> None:
    job = _claimed(store)
    job.note_photos()
    assert store.scenes.photos_of(job.scene_id) == []
    _write(job, _PHOTOS)
    job.note_photos()
    job.note_photos()
    assert store.scenes.photos_of(job.scene_id) == _PHOTOS
    _write(job, _PHOTOS[:1])
    job.note_photos()
    assert store.scenes.photos_of(job.scene_id) == _PHOTOS[:1]


def test_a_worker_that_lost_the_job_writes_nothing(store: Store) -> None:
    job = _claimed(store)
    _write(job, _PHOTOS)
    assert store.jobs.claim(job.id) is not None
    with pytest.raises(FencedError):
        job.note_photos()
    assert store.scenes.photos_of(job.scene_id) == []


def test_they_go_with_the_scene_and_do_not_come_back(store: Store) -> None:
    job = _claimed(store)
    _write(job, _PHOTOS)
    job.note_photos()
    store.scenes.delete_scene(job.scene_id)
    assert store.scenes.photos_of(job.scene_id) == []
    job.note_photos()  # its worker has not heard of it yet
    assert store.scenes.photos_of(job.scene_id) == []
