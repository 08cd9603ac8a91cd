"""`fastsplat doctor`: a healthy folder has nothing wrong; each kind of damage is named; what can be mended is."""

from __future__ import annotations

import json
import shutil
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.settings import load_settings
from fastsplat.service.store.blobs.file_digests import write_digests
from fastsplat.service.store.rows.records import NewJob, SceneSummary
from fastsplat.service.store.store import open_store
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.jobs.operations import OperationError
from tests.commands import invoke
from tests.scenes import labelled_scene, write_version

Doctor = Callable[..., tuple[int, list[dict[str, object]]]]


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A data folder with a scene that is ready, a job that failed and one that waits."""
    folder = tmp_path / "data"
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(folder))
    monkeypatch.setenv("FASTSPLAT_UPLOADS__MIN_FREE_BYTES", "0")
    store = open_store(folder)
    for name in ("ready", "failed", "waiting"):
        store.scenes.create(NewJob(name, f"op-{name}", "desk", "", "d", f"up-{name}", {}))
        if name != "ready":
            store.blobs.upload(f"up-{name}").mkdir(parents=True)
    failing, working = store.jobs.claim("op-failed"), store.jobs.claim("op-ready")
    assert failing is not None and working is not None
    store.jobs.fail(failing, to_plain(OperationError("INTERNAL", "INTERNAL", "it failed", "capture", {})))
    means = np.random.default_rng(0).normal(size=(5, 3))
    write_version(labelled_scene(means, [0] * 5, ["mug"]), store.blobs.version("ready", "v1"))
    (store.blobs.version("ready", "v1") / "summary.json").write_text("{}")
    store.jobs.succeed(working, SceneSummary("v1", 5, "METRIC", (), (), {}, 0))
    store.close()
    yield folder
    load_settings.cache_clear()


@pytest.fixture
def doctor(data: Path) -> Doctor:
    def call(*words: str) -> tuple[int, list[dict[str, object]]]:
        load_settings.cache_clear()
        result = invoke("doctor", "--json", *words)
        return result.exit_code, json.loads(result.stdout)

    return call


def test_nothing_is_wrong_with_a_healthy_folder(doctor: Doctor) -> None:
    assert doctor() == (0, [])


def test_a_version_without_a_summary_as_edits_make_them_is_well(data: Path, doctor: Doctor) -> None:
    (data / "scenes/ready/v1/summary.json").unlink()
    assert doctor() == (0, [])
    (data / "scenes/ready/v1/summary.json").write_text("{")
    assert doctor()[0] == 1


@pytest.mark.parametrize("name", ["scene.json", "gaussians.safetensors", "cameras.json", "../scene.ply"])
def test_a_flipped_bit_of_a_scene_is_named(name: str, data: Path, doctor: Doctor) -> None:
    path = data / "scenes/ready/v1/artefact" / name
    content = bytearray(path.read_bytes())
    content[len(content) * 9 // 10] ^= 4
    path.write_bytes(content)
    status, problems = doctor("--repair")  # nobody can mend it
    assert status == 1
    assert [(problem["place"], problem["mendable"]) for problem in problems] == [("scenes/ready/v1", False)]
    assert "damaged" in str(problems[0]["message"]) and problems[0]["hint"]


def test_every_damaged_file_of_a_published_version_is_named(data: Path, doctor: Doctor) -> None:
    folder = data / "scenes/ready/v1"
    write_digests(folder)
    damaged = ["artefact/scene.json", "artefact/gaussians.safetensors", "scene.ply"]
    for name in damaged:
        (folder / name).write_bytes((folder / name).read_bytes()[:-1] + b"#")
    assert sorted(str(problem["message"]).split()[8] for problem in doctor()[1]) == sorted(damaged)


def test_missing_versions_and_uploads_are_named(data: Path, doctor: Doctor) -> None:
    (data / "scenes/ready/v1").rename(data / "elsewhere")
    (data / "uploads/up-waiting").rmdir()
    status, problems = doctor()
    assert status == 1
    assert {problem["place"] for problem in problems} == {"scenes/ready/v1", "uploads/up-waiting"}


def test_what_is_left_over_and_open_to_others_is_named_and_mended(data: Path, doctor: Doctor) -> None:
    for name in ("jobs/op-failed", "uploads/up-ready", "trash/half"):
        (data / name).mkdir(parents=True)
    data.chmod(0o755)
    status, problems = doctor()
    places = {"data", "fastsplat.sqlite", "jobs/op-failed", "uploads/up-ready", "trash/half"}
    assert status == 1 and {problem["place"] for problem in problems} == places
    assert all(problem["mendable"] for problem in problems)
    assert doctor("--repair") == (0, [])
    assert data.stat().st_mode & 0o077 == 0 and (data / "uploads/up-failed").is_dir()


def test_a_scene_without_a_row_is_a_question_that_no_repair_answers(data: Path, doctor: Doctor) -> None:
    for name in ("scenes/unknown/v1", "trash/scenes/older.5", "jobs/op-failed"):
        (data / name).mkdir(parents=True)
    with closing(sqlite3.connect(data / "fastsplat.sqlite")) as connection:
        connection.execute("DELETE FROM scenes WHERE id = 'ready'")
        connection.commit()
    questions = {"scenes/unknown", "scenes/ready", "trash/scenes/older.5"}
    for words in ((), ("--repair",)):
        status, problems = doctor(*words)
        assert status == 1
        assert {problem["place"] for problem in problems if not problem["mendable"]} == questions
        assert all(problem["hint"] for problem in problems if not problem["mendable"])
    assert not (data / "jobs/op-failed").exists() and (data / "scenes/ready/v1/scene.ply").is_file()
    assert {str(path.relative_to(data)) for path in data.glob("**/scenes/*")} == questions


@pytest.mark.parametrize("url", ["", "sqlite:///{}/other.sqlite"])
def test_without_its_database_a_folder_is_left_alone_until_somebody_adopts_it(
    url: str, data: Path, doctor: Doctor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    database = data / "fastsplat.sqlite"
    monkeypatch.setenv("FASTSPLAT_DATABASE_URL", url.format(tmp_path))
    database.rename(tmp_path / "its.sqlite")
    for words in ((), ("--repair",)):
        status, problems = doctor(*words)
        assert status == 1 and [problem["place"] for problem in problems] == ["database"]
        assert "--adopt" in str(problems[0]["hint"]) and not problems[0]["mendable"]
    assert not database.exists() and not (tmp_path / "other.sqlite").exists()
    status, problems = doctor("--adopt", "--repair")
    assert status == 1 and [problem["place"] for problem in problems] == ["scenes/ready"]
    assert (data / "scenes/ready/v1/scene.ply").is_file()


def test_too_little_space_is_named(doctor: Doctor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FASTSPLAT_UPLOADS__MIN_FREE_BYTES", "1000")
    assert doctor() == (0, [])
    usage = shutil.disk_usage(".")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=999))
    status, problems = doctor()
    assert status == 1 and "free" in str(problems[0]["message"])


def test_a_damaged_database_is_named_and_left_alone(data: Path, doctor: Doctor) -> None:
    path = data / "fastsplat.sqlite"
    content = bytearray(path.read_bytes())
    content[4096:8192] = bytes(4096)
    path.write_bytes(content)
    status, problems = doctor("--repair")
    assert status == 1 and problems[0]["place"] == "fastsplat.sqlite" and not problems[0]["mendable"]
    assert path.read_bytes() == bytes(content)


def test_an_upload_of_a_job_that_failed_long_ago_is_left_over(data: Path, doctor: Doctor) -> None:
    with closing(sqlite3.connect(data / "fastsplat.sqlite")) as connection:
        connection.execute("UPDATE operations SET updated_at = ? WHERE id = 'op-failed'", (time.time() - 90_000,))
        connection.commit()
    assert [problem["place"] for problem in doctor()[1]] == ["uploads/up-failed"]
    assert doctor("--repair") == (0, [])
    assert not (data / "uploads/up-failed").exists()
