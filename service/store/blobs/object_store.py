"""Object storage of uploads and scenes, for machines without a shared folder.

It may be S3 or any fsspec file system. A folder is stored as one object per file below a prefix unique to the attempt,
then a manifest object with the prefix, files, sizes and digests. The folder exists once its manifest does;
`remove_partial` removes objects of attempts that broke off. Keys, below the URL:

    uploads/<id>/pieces/<offset>-<start of its SHA-256>   of a file that comes in pieces, named by its row
    <kind>/<id>/...  kind is `uploads` or `scenes`; scenes have one folder a version
    .../manifest.json                 written last
    .../parts-<random>/<file name>    written before
    jobs/<run id>/<file name>         progress files of running jobs, never changed
    jobs/<run id>/<stage>.<attempt>/...   results of finished stages of running jobs, as folders above
    logs/<operation id>.log           a log as it was last kept
    trash/<scene id>.<version>.<second>/<version>/...   versions that have no row
    trash/<scene id>.<second>/...     scenes that lost their rows
    identity                          see `service.store.rows.identity`

Readers copy a folder into the data directory once, checking every digest, and use the copy. Credentials come from the
store's usual sources: AWS_ACCESS_KEY_ID and so on.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime
from io import FileIO
from pathlib import Path, PurePosixPath
from tempfile import TemporaryFile
from typing import Any

from fastsplat.service.common.files import file_sha256
from fastsplat.service.store.artefact_settings import ArtefactSettings
from fastsplat.service.store.blobs.blobs import Blobs, no_data, remove, trash_name
from fastsplat.service.store.blobs.file_digests import write_digests
from fastsplat_contract.errors import ArtefactError, InvalidInputError, ObjectStoreError

_MANIFEST = "manifest.json"
_PARTS = "parts-"
_PIECE = 1 << 24
_DIGEST = 32
_STAMP = ".used"
_IDENTITY = "identity"


@dataclass(frozen=True)
class ObjectStoreBlobs(Blobs):
    """`Blobs` with uploads and scenes below `prefix` of the fsspec file system `files`.

    `cache_bytes` limits the local copies of scenes; the least recently fetched are removed first. All methods that
    reach the store may raise `ObjectStoreError`.
    """

    files: Any = field(repr=False)
    prefix: str = ""
    cache_bytes: int = 0

    def identity(self) -> str | None:
        with _store_errors():
            try:
                content: bytes = self.files.cat_file(self._key(_IDENTITY))
            except FileNotFoundError:
                return None
        return content.decode() or None

    def keep_identity(self, identity: str, *, replace: bool = False) -> str:
        with _store_errors(absence=()):
            try:
                mode = "overwrite" if replace else "create"
                self.files.pipe_file(self._key(_IDENTITY), identity.encode(), mode=mode)
            except FileExistsError:  # another process was faster
                return self.identity() or ""
        return identity

    def ids(self, kind: str) -> tuple[str, ...]:
        here = set(super().ids(kind))
        if kind in ("uploads", "scenes", "jobs"):
            here |= {PurePosixPath(name).name for name in self._list(self._key(kind))}
        return tuple(sorted(here))

    def clock(self, wall: Callable[[], float] = time.time) -> Callable[[], float]:
        """Overrides `Blobs`; machines that share no folder agree by their own clocks."""
        return wall

    def begin_data(self, upload_id: str) -> None:
        """Overrides `Blobs`; there are no bytes yet."""

    def open_data(self, upload_id: str, offset: int) -> FileIO:
        """Overrides `Blobs`; a nameless file of this machine, which no other server sees or waits for."""
        data = TemporaryFile(dir=self.root, buffering=0)  # noqa: SIM115, the caller closes it
        data.seek(offset)
        return data

    def keep_data(self, upload_id: str, data: FileIO, begin: int, end: int) -> tuple[str, ...]:
        names = []
        for offset in range(begin, end, _PIECE):
            content = os.pread(data.fileno(), min(_PIECE, end - offset), offset)
            names.append(f"{offset:020d}-{_digest(content)}")
            with _store_errors(absence=()):
                self.files.pipe_file(self._key("uploads", upload_id, "pieces", names[-1]), content)
        return tuple(names)

    def read_data(self, upload_id: str, pieces: Sequence[str]) -> Iterator[bytes]:
        """Overrides `Blobs`; raises `ArtefactError` at a damaged object."""
        for name in pieces:
            key = self._key("uploads", upload_id, "pieces", name)
            with _store_errors():
                try:
                    content: bytes = self.files.cat_file(key)
                except FileNotFoundError:
                    raise no_data(upload_id) from None
            if not name.endswith(_digest(content)):
                raise _damaged(key)
            yield content

    def keep_upload(self, upload_id: str) -> None:
        """Overrides `Blobs`; nothing stays here, as a server without a worker would never remove it."""
        self._put(self.upload(upload_id), self._key("uploads", upload_id))
        super().drop_upload(upload_id)

    def fetch_upload(self, upload_id: str) -> Path:
        """Overrides `Blobs`; raises `ArtefactError` if the upload is not there."""
        folder = self.upload(upload_id)
        if not folder.is_dir() and not self._get(self._key("uploads", upload_id), folder):
            raise ArtefactError(f"upload {upload_id} is not in the object store")
        return folder

    def drop_upload(self, upload_id: str) -> None:
        super().drop_upload(upload_id)
        self._drop(self._key("uploads", upload_id))

    def upload_age(self, upload_id: str) -> float:
        if self.upload(upload_id).is_dir():
            return super().upload_age(upload_id)
        with _store_errors():
            entries = self.files.find(self._key("uploads", upload_id), detail=True).values()
        return time.time() - max(map(_changed_at, entries), default=0.0)

    def keep_progress_file(self, run_id: str, name: str) -> None:
        with _store_errors(absence=()):
            self.files.put_file(str(self.progress_file(run_id, name)), self._key("jobs", run_id, name))

    def read_progress_file(self, run_id: str, name: str) -> bytes | None:
        with _store_errors():
            try:
                content: bytes = self.files.cat_file(self._key("jobs", run_id, name))
            except FileNotFoundError:
                return None
        return content

    def drop_progress_file(self, run_id: str, name: str) -> None:
        super().drop_progress_file(run_id, name)
        self._drop(self._key("jobs", run_id, name))

    def keep_result(self, run_id: str, stage: str, attempt: int) -> None:
        self._put(self.job(run_id) / stage, self._key("jobs", run_id, f"{stage}.{attempt}"))

    def fetch_result(self, run_id: str, stage: str, attempt: int) -> bool:
        """Overrides `Blobs`; raises `ArtefactError` if the stored files were damaged."""
        return self._get(self._key("jobs", run_id, f"{stage}.{attempt}"), self.job(run_id) / stage)

    def drop_job(self, run_id: str) -> None:
        super().drop_job(run_id)
        self._drop(self._key("jobs", run_id))

    def keep_log(self, operation_id: str) -> None:
        path = self.log(operation_id)
        with _store_errors(), suppress(FileNotFoundError):  # no trainer has started
            self.files.put_file(str(path), self._key("logs", path.name))

    def read_log(self, operation_id: str, most: int) -> bytes | None:
        with _store_errors():
            try:
                content: bytes = self.files.cat_file(self._key("logs", self.log(operation_id).name))
            except FileNotFoundError:
                return super().read_log(operation_id, most)
        return content[-most:]

    def drop_log(self, operation_id: str) -> None:
        super().drop_log(operation_id)
        self._drop(self._key("logs", self.log(operation_id).name))

    def remove_old_logs(self, retention_s: float) -> None:
        super().remove_old_logs(retention_s)
        with _store_errors():
            for name, entry in self.files.find(self._key("logs"), detail=True).items():
                if time.time() - _changed_at(entry) > retention_s:
                    self._drop(name)

    def publish(self, source: Path, scene_id: str, version: str) -> Path:
        """Overrides `Blobs`; a version that is there already stays, and `source` is removed either way."""
        write_digests(source)
        self._put(source, self._key("scenes", scene_id, version))
        remove(source)
        folder = self.fetch_version(scene_id, version)
        if folder is None:
            raise ArtefactError(f"version {version} of scene {scene_id} was removed while it was published")
        return folder

    def fetch_version(self, scene_id: str, version: str) -> Path | None:
        """Overrides `Blobs`; may return a local copy of a scene removed elsewhere.

        Raises:
            ArtefactError: the stored files were damaged.
        """
        folder = self.version(scene_id, version)
        if not folder.is_dir():
            if not self._get(self._key("scenes", scene_id, version), folder):
                return None
            self._shrink(keep=folder)
        try:
            (folder / _STAMP).touch()
        except FileNotFoundError:  # another process shrank the cache just now
            return self.fetch_version(scene_id, version)
        return folder

    def drop_version(self, scene_id: str, version: str) -> None:
        self._drop(self._key("scenes", scene_id, version))
        super().drop_version(scene_id, version)

    def versions(self) -> dict[tuple[str, str], float]:
        """Overrides `Blobs`; does not count copies on this machine."""
        published = {}
        with _store_errors():
            for name, entry in self.files.find(self._key("scenes"), detail=True).items():
                path = PurePosixPath(name)
                if path.name == _MANIFEST:
                    published[path.parts[-3], path.parts[-2]] = _changed_at(entry)
        return published

    def trash_version(self, scene_id: str, version: str, now: float) -> None:
        self._copy(
            self._key("scenes", scene_id, version),
            self._key("trash", trash_name(f"{scene_id}.{version}", now), version),
        )
        self.drop_version(scene_id, version)

    def drop_scene(self, scene_id: str) -> None:
        self._drop(self._key("scenes", scene_id))
        super().drop_scene(scene_id)

    def trash_scene(self, scene_id: str, now: float) -> None:
        self._copy(self._key("scenes", scene_id), self._key("trash", trash_name(scene_id, now)))
        self.drop_scene(scene_id)

    def _copy(self, source: str, target: str) -> None:
        """Copies all objects below a key, manifests last, as object stores cannot rename."""
        with _store_errors():
            for name in sorted(self.files.find(source), key=lambda name: name.endswith(f"/{_MANIFEST}")):
                with suppress(FileNotFoundError):  # another worker moved it first
                    self.files.cp_file(name, target + str(name).partition(source)[2])

    def trashed_scenes(self) -> tuple[str, ...]:
        return tuple(sorted(PurePosixPath(name).name for name in self._list(self._key("trash"))))

    def drop_trashed(self, name: str) -> None:
        self._drop(self._key("trash", name))

    def remove_partial(self, expiry_s: float) -> None:
        """Overrides `Blobs`; also removes parts that no manifest names."""
        super().remove_partial(expiry_s)
        for path in (self.root / "incoming").glob("*"):
            if time.time() - path.stat().st_mtime > expiry_s:
                remove(path)
        for kind in ("uploads", "scenes"):
            for parts, (age, folder) in self._parts(self._key(kind)).items():
                if age > expiry_s and (self._manifest(folder) or {}).get("parts") != parts:
                    self._drop(f"{folder}/{parts}")

    def _put(self, source: Path, key: str) -> None:
        parts = f"{_PARTS}{uuid.uuid4().hex}"
        names = sorted(path.relative_to(source).as_posix() for path in source.rglob("*") if path.is_file())
        entries = {
            name: {"size": (source / name).stat().st_size, "sha256": file_sha256(source / name)} for name in names
        }
        with _store_errors(absence=()):
            for name in names:
                self.files.put_file(str(source / name), f"{key}/{parts}/{name}")
            manifest = json.dumps({"parts": parts, "files": entries}).encode()
            try:
                self.files.pipe_file(f"{key}/{_MANIFEST}", manifest, mode="create")
            except FileExistsError:  # another attempt was faster, and what it put stands
                self.files.rm(f"{key}/{parts}", recursive=True)

    def _get(self, key: str, target: Path) -> bool:
        """Copies a folder to `target`, whole or not at all; False if there is none."""
        manifest = self._manifest(key)
        if manifest is None:
            return False
        copying = self.root / "incoming" / uuid.uuid4().hex
        try:
            copying.mkdir(parents=True)
            for name, entry in manifest["files"].items():
                if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
                    raise ArtefactError(f"the object store has an unsafe file name: {name[:80]!r}")
                path, part = copying / name, f"{key}/{manifest['parts']}/{name}"
                path.parent.mkdir(parents=True, exist_ok=True)
                with _store_errors():
                    self.files.get_file(part, str(path))
                if path.stat().st_size != entry["size"] or file_sha256(path) != entry["sha256"]:
                    raise _damaged(part)
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                copying.rename(target)
            except OSError:
                if not target.is_dir():  # else another thread or process was faster
                    raise
        except FileNotFoundError:
            if self._manifest(key) is None:  # removed while it was read
                return False
            raise
        finally:
            remove(copying)
        return True

    def _manifest(self, key: str) -> dict[str, Any] | None:
        with _store_errors():
            try:
                manifest: dict[str, Any] = json.loads(self.files.cat_file(f"{key}/{_MANIFEST}"))
            except FileNotFoundError:
                return None
        return manifest

    def _drop(self, key: str) -> None:
        # Manifests first: without one, the folder does not exist.
        with _store_errors():
            names = self.files.find(key)
            for name in sorted(names, key=lambda name: not name.endswith(f"/{_MANIFEST}")):
                try:
                    self.files.rm_file(name)
                except FileNotFoundError:
                    continue
            if self.files.isdir(key):  # file systems with folders
                self.files.rm(key, recursive=True)

    def _list(self, key: str) -> list[str]:
        with _store_errors():
            try:
                return [str(name) for name in self.files.ls(key, detail=False)]
            except FileNotFoundError:
                return []

    def _parts(self, key: str) -> dict[str, tuple[float, str]]:
        """Maps parts to (age of the youngest object in seconds, key of their folder)."""
        youngest: dict[str, tuple[float, str]] = {}
        with _store_errors():
            for name, entry in self.files.find(key, detail=True).items():
                folder, mark, rest = name.partition(f"/{_PARTS}")
                if mark:
                    parts = _PARTS + rest.split("/", 1)[0]
                    age = time.time() - _changed_at(entry)
                    youngest[parts] = (min(age, youngest.get(parts, (age, ""))[0]), folder)
        return youngest

    def _shrink(self, keep: Path) -> None:
        copies = []
        for folder in (self.root / "scenes").glob("*/*"):
            stamp = folder / _STAMP
            used_at = stamp.stat().st_mtime if stamp.exists() else time.time()
            copies.append((used_at, folder, sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())))
        excess = sum(size for _, _, size in copies) - self.cache_bytes
        for _, folder, size in sorted(copies):
            if excess > 0 and folder != keep:
                self._discard(folder)
                excess -= size

    def _key(self, *names: str) -> str:
        self._folder(*names)
        return "/".join((self.prefix, *names) if self.prefix else names)


def open_blobs(root: Path, settings: ArtefactSettings) -> Blobs:
    """Opens the folder `root` or an object store; unsupported URLs raise `InvalidInputError`."""
    if not settings.url:
        return Blobs(root)
    import fsspec

    # No cache of listings: other processes write.
    options: dict[str, Any] = {"use_listings_cache": False, "skip_instance_cache": True}
    if settings.url.startswith("file:"):
        options["auto_mkdir"] = True
    if settings.endpoint_url:
        options["endpoint_url"] = settings.endpoint_url
    try:
        files, prefix = fsspec.core.url_to_fs(settings.url, **options)
    except (ImportError, ValueError) as error:
        raise InvalidInputError(
            f"no object store can be opened at {settings.url[:80]!r}: {error}",
            field="artefacts.url",
            hint='Write it as s3://bucket/folder, and install "fastsplat[s3]"; or leave it empty for the data folder.',
        ) from error
    return ObjectStoreBlobs(root, files, str(prefix).rstrip("/"), settings.cache_bytes)


@contextmanager
def _store_errors(absence: tuple[type[OSError], ...] = (FileNotFoundError,)) -> Iterator[None]:
    """Turns errors of the store's client into `ObjectStoreError`; `absence` passes through."""
    try:
        yield
    except absence:
        raise
    except Exception as error:  # every store's client has errors of its own
        raise ObjectStoreError(f"the object store does not answer ({type(error).__name__})") from error


def _damaged(key: str) -> ArtefactError:
    return ArtefactError(f"{key} was damaged in the object store or on the way")


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_DIGEST]


def _changed_at(entry: Mapping[str, Any]) -> float:
    """Returns a listing entry's time in seconds since 1970; file systems name the field differently."""
    moment = next(
        entry[word] for word in ("LastModified", "last_modified", "mtime", "updated", "created") if word in entry
    )
    return moment.timestamp() if isinstance(moment, datetime) else float(moment)
