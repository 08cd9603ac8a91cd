"""Uploads and scenes in an object store: an S3 server on loopback, a folder, and memory; the same laws for all."""

from __future__ import annotations

import os
import uuid
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import fsspec
import pytest

from fastsplat.service.store.artefact_settings import ArtefactSettings
from fastsplat.service.store.blobs.file_digests import DIGESTS
from fastsplat.service.store.blobs.object_store import ObjectStoreBlobs, open_blobs
from fastsplat_contract.errors import ArtefactError, InvalidInputError, ObjectStoreError


@pytest.fixture(params=["s3", "file", "memory"])
def settings(request: pytest.FixtureRequest, tmp_path: Path) -> ArtefactSettings:
    """An empty place in each kind of store."""
    if request.param == "file":
        return ArtefactSettings(url=f"file://{tmp_path}/bucket")
    if request.param == "memory":
        return ArtefactSettings(url=f"memory://{uuid.uuid4().hex}/x")
    endpoint = request.getfixturevalue("s3")
    bucket = f"b{uuid.uuid4().hex}"
    fsspec.filesystem("s3", endpoint_url=endpoint, skip_instance_cache=True).mkdir(bucket)
    return ArtefactSettings(url=f"s3://{bucket}/some/folder", endpoint_url=endpoint)


@pytest.fixture
def here(settings, tmp_path) -> ObjectStoreBlobs:
    """One machine."""
    return open_blobs(tmp_path / "here", settings)


@pytest.fixture
def there(settings, tmp_path) -> ObjectStoreBlobs:
    """Another machine, with no folder in common."""
    return open_blobs(tmp_path / "there", settings)


def _version_folder(folder: Path, text: str = "{}") -> Path:
    (folder / "artefact").mkdir(parents=True)
    (folder / "artefact" / "scene.json").write_text(text)
    (folder / "artefact" / "empty").touch()
    (folder / "scene.ply").write_bytes(os.urandom(100_000))
    return folder


def _content(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file() and path.name not in (".used", DIGESTS))
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def _objects(blobs: ObjectStoreBlobs) -> list[str]:
    return [str(name) for name in blobs.files.find(blobs.prefix)]


def test_what_one_machine_publishes_every_other_reads_byte_for_byte(here, there, tmp_path):
    content = _content(_version_folder(tmp_path / "work"))
    assert there.fetch_version("scene", "v1") is None
    assert _content(here.publish(tmp_path / "work", "scene", "v1")) == content
    assert not (tmp_path / "work").exists()
    folder = there.fetch_version("scene", "v1")
    assert folder is not None and _content(folder) == content
    assert folder.is_relative_to(there.root)
    assert there.ids("scenes") == here.ids("scenes") == ("scene",)


def test_an_upload_reaches_workers_that_share_no_folder(here, there):
    _version_folder(here.upload("up"), "what the user sent")
    (here.upload("up") / ".validated").mkdir()
    (here.upload("up") / ".validated" / "manifest.json").write_text("[]")
    content = _content(here.upload("up"))
    here.keep_upload("up")
    assert not here.upload("up").exists()
    assert 0 <= there.upload_age("up") < 3600 and there.ids("uploads") == ("up",)
    assert _content(there.fetch_upload("up")) == content
    there.drop_upload("up")
    assert _objects(here) == []
    with pytest.raises(ArtefactError):
        open_blobs(there.root / "third", ArtefactSettings(url="memory://nothing")).fetch_upload("up")


@pytest.mark.parametrize("part", [0, 1, 2, 3])
def test_a_crash_between_two_parts_leaves_nothing_to_see_and_the_next_attempt_publishes(
    here, there, tmp_path, monkeypatch, part
):
    class Crash(BaseException):
        """As a kill would be: nothing is caught, nothing cleaned up."""

    calls = []

    def crash_at(name):
        whole = getattr(here.files, name)

        def crashing(*arguments, **options):
            calls.append(name)
            if len(calls) > part:
                raise Crash
            return whole(*arguments, **options)

        return crashing

    with monkeypatch.context() as patch:
        for name in ("put_file", "pipe_file"):
            patch.setattr(here.files, name, crash_at(name))
        with pytest.raises(Crash):
            here.publish(_version_folder(tmp_path / "first"), "scene", "v1")

    assert len(_objects(here)) == part
    assert here.fetch_version("scene", "v1") is None and there.fetch_version("scene", "v1") is None
    here.publish(_version_folder(tmp_path / "second", "second"), "scene", "v1")
    folder = there.fetch_version("scene", "v1")
    assert folder is not None and (folder / "artefact" / "scene.json").read_text() == "second"
    here.remove_partial(expiry_s=3600)
    assert len(_objects(here)) == part + 5  # they might still be at work
    here.remove_partial(expiry_s=-1)
    assert len(_objects(here)) == 5
    assert there.fetch_version("scene", "v1") is not None


def test_of_two_attempts_at_one_version_the_first_stands_whole(here, there, tmp_path):
    first = _content(_version_folder(tmp_path / "first", "first"))
    here.publish(tmp_path / "first", "scene", "v1")
    assert _content(there.publish(_version_folder(tmp_path / "second", "second"), "scene", "v1")) == first
    assert len(_objects(here)) == 5


def test_damage_in_the_store_is_noticed_and_nothing_of_it_is_used(here, there, tmp_path):
    here.publish(_version_folder(tmp_path / "work"), "scene", "v1")
    ply = next(name for name in _objects(here) if name.endswith("scene.ply"))
    here.files.pipe_file(ply, b"damaged")
    with pytest.raises(ArtefactError):
        there.fetch_version("scene", "v1")
    assert not there.version("scene", "v1").exists()


def test_what_is_dropped_is_gone_everywhere_and_open_files_can_be_read_on(here, there, tmp_path):
    here.publish(_version_folder(tmp_path / "one"), "scene", "v1")
    here.publish(_version_folder(tmp_path / "two"), "scene", "v2")
    folder = there.fetch_version("scene", "v1")
    with (folder / "scene.ply").open("rb") as reader:
        there.drop_version("scene", "v1")
        assert len(reader.read()) == 100_000
    assert there.fetch_version("scene", "v1") is None and there.fetch_version("scene", "v2") is not None
    here.drop_scene("scene")
    assert _objects(here) == [] and here.ids("scenes") == ()
    assert here.fetch_version("scene", "v2") is None


@pytest.mark.parametrize("settings", ["s3", "file"], indirect=True)  # memory's files are not for several threads
def test_many_readers_at_once_share_one_copy(here, there, tmp_path):
    here.publish(_version_folder(tmp_path / "work"), "scene", "v1")
    with ThreadPoolExecutor(8) as pool:
        folders = set(pool.map(lambda _: there.fetch_version("scene", "v1"), range(16)))
    assert folders == {there.version("scene", "v1")}
    assert list((there.root / "incoming").iterdir()) == []


def test_copies_stay_within_their_budget_the_least_recently_fetched_leave(here, settings, tmp_path):
    small = settings.model_copy(update={"cache_bytes": 250_000})
    there = open_blobs(tmp_path / "there", small)
    for number in range(4):
        here.publish(_version_folder(tmp_path / f"work{number}"), f"scene{number}", "v1")
    for number in (0, 1, 0, 2):
        folder = there.fetch_version(f"scene{number}", "v1")
        os.utime(folder / ".used", (len(list(there.root.rglob("*"))), 1000 + number + 10 * (number == 0)))
    assert [there.version(f"scene{number}", "v1").is_dir() for number in range(3)] == [True, False, True]
    assert there.fetch_version("scene1", "v1") is not None  # and it comes again


def test_a_store_that_is_away_is_a_typed_error(tmp_path, s3):
    gone = ArtefactSettings(url="s3://no-such-bucket/x", endpoint_url=s3)
    with pytest.raises(ObjectStoreError) as caught:
        open_blobs(tmp_path, gone).publish(_version_folder(tmp_path / "work"), "scene", "v1")
    assert caught.value.hint and (tmp_path / "work").is_dir()


def test_a_url_that_nothing_speaks_is_refused(tmp_path):
    with pytest.raises(InvalidInputError, match="nonsense"):
        open_blobs(tmp_path, ArtefactSettings(url="nonsense://x"))


def test_what_can_be_looked_at_is_seen_everywhere_and_goes_with_its_job(
    here: ObjectStoreBlobs, there: ObjectStoreBlobs
) -> None:
    for run, name in (("job", "preview-1-1.jpg"), ("job", "preview-1-2.jpg"), ("job.1", "preview-1-1.jpg")):
        path = here.progress_file(run, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(f"{run} {name}".encode())
        here.keep_progress_file(run, name)
    assert there.read_progress_file("job", "preview-1-2.jpg") == b"job preview-1-2.jpg"
    assert there.read_progress_file("job", "preview-1-3.jpg") is None
    here.drop_progress_file("job", "preview-1-1.jpg")
    assert there.read_progress_file("job", "preview-1-1.jpg") is None
    result = _version_folder(here.job("job") / "capture")
    here.keep_result("job", "capture", 2)
    assert there.fetch_result("job", "capture", 2) and _content(there.job("job") / "capture") == _content(result)
    assert not there.fetch_result("job", "capture", 1)
    assert set(there.ids("jobs")) == {"job", "job.1"}
    there.drop_job("job")  # another machine's cleanup, e.g.
    assert here.read_progress_file("job", "preview-1-2.jpg") is None
    assert not here.fetch_result("job", "capture", 2)
    assert here.read_progress_file("job.1", "preview-1-1.jpg") == b"job.1 preview-1-1.jpg"
    here.drop_job("job.1")
    here.drop_job("job")
    assert _objects(here) == [] and here.ids("jobs") == ()


@pytest.mark.parametrize("remove", [lambda blobs: blobs.drop_log("job"), lambda blobs: blobs.remove_old_logs(-1.0)])
def test_a_log_is_read_everywhere_as_it_was_last_kept(here, there, remove) -> None:
    here.keep_log("job")
    assert there.read_log("job", 10) is None
    here.log("job").parent.mkdir(parents=True)
    for text in (b"first", b"first, second"):
        here.log("job").write_bytes(text)
        here.keep_log("job")
        assert there.read_log("job", 10) == text[-10:]
    remove(there)
    assert there.read_log("job", 10) is None and _objects(here) == []
    assert here.read_log("job", 10) == b"st, second"  # its own file
