"""Model archives, for machines without a network.

An archive is a zip with files at MODEL/FILE, as in a model directory. Only files of the manifest are read, by name.
Known digests are checked, and every model is tried out before it appears, as in a pull.
"""

from __future__ import annotations

import hashlib
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from fastsplat.service.perception.model_pull.model_check import check_model
from fastsplat.service.perception.model_pull.pull import Step, check_writable, model_state, put_in_place
from fastsplat.service.perception.models.model_files import RECEIPT, read_receipt
from fastsplat.service.perception.models.model_manifest import ModelEntry, load_manifest
from fastsplat_contract.errors import ChecksumMismatchError, InvalidInputError, ResourceError, UnsafeArchiveError

_MOST_FILE_BYTES, _MOST_RECEIPT_BYTES = 8 << 30, 1 << 20
_CHUNK = 1 << 20


def unpack(
    source: Path, models: Path, *, report: Callable[[Step], None], manifest: Path | None = None
) -> Sequence[str]:
    """Puts an archive's models into the model directory, except those that are there and sound.

    A model appears by a rename, after its digests and a trial have passed. The first failure ends it; earlier models
    stay.

    Returns:
        The models in the archive.

    Raises:
        InvalidInputError: the file is no such archive.
        UnsafeArchiveError: it has models or files unknown to the manifest, lacks a file, or has one twice or too large.
        ChecksumMismatchError: bytes are not those of the manifest.
        ResourceError: the model directory cannot be written.
        ModelUnavailableError: a model does not work.
    """
    entries = {entry.name: entry for entry in load_manifest(manifest)}
    try:
        with zipfile.ZipFile(source) as archive:
            held = _models_in(archive, entries)
            check_writable(models)
            with tempfile.TemporaryDirectory(prefix=".unpack-", dir=models) as work:
                for name in held:
                    if model_state(entries[name], models) == "ready":
                        report(Step(name, "already there"))
                        continue
                    staged = Path(work) / "models" / name
                    staged.mkdir(parents=True)
                    if f"{name}/{RECEIPT}" in archive.namelist():
                        _extract(archive, f"{name}/{RECEIPT}", staged / RECEIPT, None, report)
                    noted = read_receipt(staged, name=name).sha256
                    for file in entries[name].files:
                        sha256 = file.sha256 or noted.get(file.name)
                        _extract(archive, f"{name}/{file.name}", staged / file.name, sha256, report)
                    report(Step(name, "trying it out"))
                    check_model(entries[name], Path(work) / "models")
                    put_in_place(staged, models / name, entries[name])
                    report(Step(name, "ready"))
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise InvalidInputError(
            f"{source} is not whole, or is no archive of models",
            field="archive",
            hint="Copy it or zip the models again.",
        ) from error
    except FileNotFoundError as error:
        raise InvalidInputError(f"there is no file {source}", field="archive") from error
    except OSError as error:
        raise ResourceError(f"{source} cannot be unpacked: {error.strerror}", field="archive") from error
    return held


def _models_in(archive: zipfile.ZipFile, entries: Mapping[str, ModelEntry]) -> Sequence[str]:
    """Lists an archive's models; checks their files for names, duplicates and size."""
    members = [info for info in archive.infolist() if not info.is_dir()]
    held = list(dict.fromkeys(info.filename.partition("/")[0] for info in members))
    if not held:
        raise InvalidInputError("the archive has no models", field="archive", hint="Zip folders of a model directory.")
    for name in held:
        if name not in entries:
            raise UnsafeArchiveError(f'the manifest has no model "{name}"', field="archive")
        files = {f"{name}/{file.name}": file.size or _MOST_FILE_BYTES for file in entries[name].files}
        # A calibration is of the machine that made it.
        infos = [
            i
            for i in members
            if i.filename.partition("/")[0] == name and not i.filename.startswith(f"{name}/calibration.")
        ]
        receipt = f"{name}/{RECEIPT}"
        if sorted(info.filename for info in infos if info.filename != receipt) != sorted(files):
            raise UnsafeArchiveError(
                f"model {name} has the files {', '.join(sorted(files))}, and the archive others", field="archive"
            )
        for info in infos:
            if info.file_size > (limit := files.get(info.filename, _MOST_RECEIPT_BYTES)):
                raise UnsafeArchiveError(
                    f"{info.filename} has {info.file_size} bytes", field="archive", limit=f"{limit} bytes"
                )
    return held


def _extract(
    archive: zipfile.ZipFile, member: str, target: Path, sha256: str | None, report: Callable[[Step], None]
) -> None:
    digest, total = hashlib.sha256(), archive.getinfo(member).file_size
    with archive.open(member) as stream, target.open("wb") as out:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
            out.write(chunk)
            report(Step(target.parent.name, f"verifying {target.name}", out.tell(), total))
    if sha256 is not None and digest.hexdigest() != sha256:
        raise ChecksumMismatchError(f"{member} does not have the sha256 {sha256}", field="archive")
