"""The database goes away in mid-job, or the disk under it is full: the job goes on, or fails with a reason."""

from __future__ import annotations

import sqlite3
import time
from contextlib import closing

import pytest
from sqlalchemy import event

from fastsplat.workers.engine.cleanup import remove_unneeded
from fastsplat_contract.errors import DatabaseError
from tests.workers.deployment import STAGES, Deployment, on_both_databases

_WITHOUT_DATABASE_S = 2.0


@on_both_databases()
def test_the_database_restarts_in_mid_job_and_the_job_is_done_once(deployment, request):
    first, second = deployment.post("perception:until_told"), deployment.post()
    worker = deployment.start_worker()
    deployment.wait_in("perception", first)
    flag = deployment.settings.data_dir / "told.txt"

    if deployment.settings.database_url:
        server = request.getfixturevalue("postgres")
        server.crash()
        with pytest.raises(DatabaseError):
            deployment.post()  # whose files stay for a while: for all it knows, the job is there
        flag.touch()
        deployment.wait_in("export", first)  # the worker cannot write that a stage is complete
        time.sleep(_WITHOUT_DATABASE_S)
        server.start()
    else:
        path = deployment.settings.data_dir / "fastsplat.sqlite"
        with closing(sqlite3.connect(path, timeout=60, isolation_level=None)) as held:
            held.execute("BEGIN IMMEDIATE")
            flag.touch()
            deployment.wait_in("export", first)  # only writers wait

    for operation in (first, second):
        assert deployment.wait_over(operation).state == "SUCCEEDED"
    assert worker.poll() is None
    assert all(len(deployment.visits(stage)) == 2 for stage in STAGES)
    store = deployment.service._store
    remove_unneeded(store, upload_expiry_s=-1, ended_job_retention_s=60, failed_upload_retention_s=-1)
    deployment.wait_for(lambda: deployment.left_over() == [])


def test_a_trainer_that_fills_its_disk_ends_with_that_reason_and_the_next_job_goes_on(deployment):
    large, small = deployment.post("training:write 9"), deployment.post("training:write 1")
    deployment.start_worker(max_file=8 << 20)

    over = deployment.wait_over(large)

    assert over.state == "FAILED" and over.error is not None
    assert (over.error.kind, over.error.reason) == ("RESOURCE_EXHAUSTED", "OUT_OF_RESOURCES")
    assert over.error.stage == "training" and "full" in over.error.message and over.error.details["hint"]
    assert deployment.service.get_scene(large.scene_id).state == "FAILED"
    assert deployment.wait_over(small).state == "SUCCEEDED"
    assert deployment.service._store.blobs.ids("scenes") == (small.scene_id,)
    deployment.wait_for(lambda: deployment.left_over() == deployment.uploads_of(large))


def test_a_full_disk_under_the_database_refuses_a_job_whole_and_takes_it_once_there_is_room(tmp_path):
    deployment = Deployment(tmp_path, "")
    path = deployment.settings.data_dir / "fastsplat.sqlite"
    with deployment.service._store.engine.connect() as connection:
        pages = connection.exec_driver_sql("PRAGMA page_count").scalar()
    limit = {"pages": pages}

    def full(connection, record) -> None:
        connection.execute(f"PRAGMA max_page_count={limit['pages']}")

    event.listen(deployment.service._store.engine, "connect", full)
    deployment.service._store.engine.dispose()
    admitted = []

    def post_until_full() -> None:
        while True:
            admitted.append(deployment.post("training:" + "x" * 190, request_id=f"{len(admitted)}"))

    with pytest.raises(DatabaseError) as caught:
        post_until_full()
    assert caught.value.hint

    limit["pages"] = pages + 1000
    deployment.service._store.engine.dispose()
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT count(*) FROM operations").fetchone() == (len(admitted),)
        assert connection.execute("SELECT count(*) FROM scenes").fetchone() == (len(admitted),)
    again = deployment.post("training:" + "x" * 190, request_id=f"{len(admitted)}")
    assert deployment.state(again) == "QUEUED"
    deployment.close()
