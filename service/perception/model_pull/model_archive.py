"""Models in one file, for machines without a network: packed where they are, unpacked where they are to be.

The archive is a zip without compression: `models.json` names each model's files with their sha256, and each file lies
at MODEL/FILE. Only models of the built-in manifest are taken, file by file by name, so nothing else in an archive is
ever read. Where the manifest knows a file's digest, that one counts and not the archive's own; every model is tried out
before it appears, as in a pull.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from fastsplat.service.common.atomic import atomic_file
from fastsplat.service.perception.model_pull.model_check import check_model
from fastsplat.service.perception.model_pull.pull import Step, check_writable, model_state, put_in_place
from fastsplat.service.perception.models.model_manifest import ModelEntry, load_manifest
from fastsplat.service.perception.onnx_session import file_sha256
from fastsplat_contract.errors import (
    ChecksumMismatchError,
    InvalidInputError,
    NotFoundError,
    ResourceError,
    UnsafeArchiveError,
)

_LIST = "models.json"
_MOST_LIST_BYTES = 1 << 20
_MOST_FILE_BYTES = 8 << 30
_CHUNK = 1 << 20


class _List(BaseModel):
    """What an archive holds: sha256 by file name, by model."""

    model_config = ConfigDict(extra="forbid")

    format: Literal[1] = 1
    models: dict[str, dict[str, Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]]] = Field(max_length=1_000)


def pack(models: Path, target: Path, names: Sequence[str] = (), *, manifest: Path | None = None) -> Sequence[str]:
    """Write models of the model directory into one file, which is there whole or not at all.

    Args:
        names: manifest entries; none: all that the directory has whole.
        manifest: another manifest than the built-in one.

    Returns:
        The models that were packed.

    Raises:
        InvalidInputError: an unknown name.
        NotFoundError: a model is not there, or damaged.
        ResourceError: the archive cannot be written.
    """
    entries = {entry.name: entry for entry in load_manifest(manifest)}
    if unknown := [name for name in names if name not in entries]:
        raise InvalidInputError(
            f'the manifest has no model "{unknown[0]}"', field="name", hint=f"Choose among {', '.join(entries)}."
        )
    whole = [
        name for name in (names or entries) if _has_all(entries[name], models) and _is_sound(entries[name], models)
    ]
    if missing := [name for name in names if name not in whole] or ([] if whole else ["any model"]):
        raise NotFoundError(
            f"{models} does not have {missing[0]}, whole and undamaged", field="name", hint="Run: fastsplat models pull"
        )
    files = {name: [file.name for file in entries[name].files] for name in whole}
    digests = {name: {file: file_sha256(models / name / file) for file in each} for name, each in files.items()}
    try:
        with atomic_file(target) as partial, zipfile.ZipFile(partial, "w") as archive:
            archive.writestr(_LIST, _List(models=digests).model_dump_json(indent=1))
            for name, each in files.items():
                for file in each:
                    archive.write(models / name / file, f"{name}/{file}")
    except OSError as error:
        raise ResourceError(f"{target} cannot be written: {error.strerror}", field="archive") from error
    return whole


def unpack(
    source: Path, models: Path, *, report: Callable[[Step], None], manifest: Path | None = None
) -> Sequence[str]:
    """Put the models of an archive into the model directory; those that are there and sound are left alone.

    A model appears in one rename, after its bytes have matched and its adapter has solved a drawn exercise. The first
    model that fails ends it; those before it stay.

    Returns:
        The models that the archive has.

    Raises:
        InvalidInputError: the file is no such archive.
        UnsafeArchiveError: it names models or files that the manifest does not have, or a file twice, or one larger
            than it may be.
        ChecksumMismatchError: bytes are not those of the manifest, or of the archive's list.
        ResourceError: the model directory cannot be written.
        ModelUnavailableError: a model does not work.
    """
    entries = {entry.name: entry for entry in load_manifest(manifest)}
    try:
        with zipfile.ZipFile(source) as archive:
            listed = _listed(archive)
            _check_list(listed, entries, archive)
            check_writable(models)
            with tempfile.TemporaryDirectory(prefix=".unpack-", dir=models) as work:
                for name, digests in listed.items():
                    if model_state(entries[name], models) == "ready":
                        report(Step(name, "already there"))
                        continue
                    staged = Path(work) / "models" / name
                    staged.mkdir(parents=True)
                    for file, digest in digests.items():
                        _extract(
                            archive, f"{name}/{file}", staged / file, _known(entries[name], file) or digest, report
                        )
                    report(Step(name, "trying it out"))
                    check_model(entries[name], Path(work) / "models")
                    put_in_place(staged, models / name, entries[name])
                    file_sha256.cache_clear()  # under these paths are other files now
                    report(Step(name, "ready"))
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise InvalidInputError(
            f"{source} is not whole, or is no archive of models", field="archive", hint="Copy or pack it again."
        ) from error
    except OSError as error:
        raise ResourceError(f"{source} cannot be unpacked: {error.strerror}", field="archive") from error
    return list(listed)


def _listed(archive: zipfile.ZipFile) -> Mapping[str, Mapping[str, str]]:
    try:
        info = archive.getinfo(_LIST)
        if info.file_size > _MOST_LIST_BYTES:
            raise UnsafeArchiveError(f"{_LIST} has more than {_MOST_LIST_BYTES} bytes", field="archive")
        return _List.model_validate(json.loads(archive.read(info))).models
    except (KeyError, ValidationError, ValueError) as error:
        raise InvalidInputError(
            f"the archive has no list of models ({_LIST}) that this release can read",
            field="archive",
            hint="Pack it again with the release that unpacks it.",
        ) from error


def _check_list(
    listed: Mapping[str, Mapping[str, str]], entries: Mapping[str, ModelEntry], archive: zipfile.ZipFile
) -> None:
    """See that every file is one of the manifest's, is there once, and is not larger than it may be."""
    for name, digests in listed.items():
        if name not in entries:
            raise UnsafeArchiveError(f'the manifest has no model "{name}"', field="archive")
        sizes = {file.name: file.size for file in entries[name].files}
        if set(digests) != set(sizes):
            raise UnsafeArchiveError(
                f"model {name} has the files {', '.join(sorted(sizes))}, and the archive lists others", field="archive"
            )
        for file in digests:
            infos = [info for info in archive.infolist() if info.filename == f"{name}/{file}"]
            if len(infos) != 1:
                raise UnsafeArchiveError(
                    f"{name}/{file} is {len(infos)} times in the archive, not once", field="archive"
                )
            most = sizes[file] or _MOST_FILE_BYTES
            if infos[0].file_size > most:
                raise UnsafeArchiveError(
                    f"{name}/{file} has {infos[0].file_size} bytes", field="archive", limit=f"{most} bytes"
                )


def _extract(archive: zipfile.ZipFile, member: str, target: Path, sha256: str, report: Callable[[Step], None]) -> None:
    digest, total = hashlib.sha256(), archive.getinfo(member).file_size
    with archive.open(member) as stream, target.open("wb") as out:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
            out.write(chunk)
            report(Step(target.parent.name, f"verifying {target.name}", out.tell(), total))
    if digest.hexdigest() != sha256:
        raise ChecksumMismatchError(f"{member} does not have the sha256 {sha256}", field="archive")


def _known(entry: ModelEntry, file: str) -> str | None:
    return next(each.sha256 for each in entry.files if each.name == file)


def _has_all(entry: ModelEntry, models: Path) -> bool:
    return all((models / entry.name / file.name).is_file() for file in entry.files)


def _is_sound(entry: ModelEntry, models: Path) -> bool:
    return model_state(entry, models) in ("ready", "unverified")
