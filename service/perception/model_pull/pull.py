"""Model pulls: fetch, checksum, conversion, trial, and a rename at the end."""

from __future__ import annotations

import json
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fastsplat.service.perception.model_pull.hub import RefusedError, pinned
from fastsplat.service.perception.model_pull.model_check import check_model
from fastsplat.service.perception.model_pull.sources import fetch_file, run_pip
from fastsplat.service.perception.models.model_files import RECEIPT, Receipt, read_receipt
from fastsplat.service.perception.models.model_manifest import (
    BUILT_IN_MANIFEST,
    Conversion,
    HubSource,
    ModelEntry,
    select_models,
)
from fastsplat.service.perception.onnx_session import file_sha256
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError, ResourceError

ModelState = Literal["ready", "unverified", "damaged", "absent"]

_WRITABLE = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH
_ELSEWHERE = "Allow writing (chmod u+w), or name another directory with --models or FASTSPLAT_MODELS."

_TIMEOUT_S = 900
_SCRIPTS = {"paddle": "convert_paddle.py", "mobile_sam": "convert_mobile_sam.py"}


@dataclass(frozen=True)
class Step:
    """Progress of a pull: `done` of `total` bytes, both 0 if unknown."""

    model: str
    what: str
    done: int = 0
    total: int = 0


def pull(
    models: Path,
    names: Sequence[str] = (),
    *,
    report: Callable[[Step], None],
    planned: Callable[[ModelEntry], None] = lambda entry: None,
    manifest: Path | None = None,
    allow_licenses: Collection[str] = (),
    revision: str | None = None,
) -> None:
    """Puts models into the model directory, except those that are there and work.

    A model appears by a rename, after checksums, conversion and a trial; a failure leaves nothing behind.

    Args:
        models: the model directory, made if missing.
        names: models and sets of the manifest; none: the defaults.
        planned: called with each missing model, of known commits and sizes, before any file is fetched.
        manifest: another manifest than the built-in one.
        allow_licenses: SPDX names to accept beyond the permissive ones.
        revision: commit, branch or tag for Hugging Face repositories without a commit in the manifest; models of
            other commits are replaced. None: that of the first pull, otherwise the newest.

    Raises:
        InvalidInputError: an unknown name, or a license that needs consent; nothing was fetched.
        ResourceError: the directory, or a folder to be replaced, is read-only or cannot be written; nothing was
            fetched.
        ModelUnavailableError: a source, a checksum, a conversion or a trial failed.
    """
    source = manifest or BUILT_IN_MANIFEST
    selected = select_models(names, source)
    for entry in selected:
        if not entry.permissive and entry.license not in allow_licenses:
            raise InvalidInputError(
                f"model {entry.name} is under {entry.license}, which is not a permissive license",
                field="license",
                hint=f"If its terms suit you, repeat with --allow-license {entry.license}.",
            )
    missing = [entry for entry in selected if not _is_there(entry, models, revision, report)]
    if not missing:
        return
    check_writable(models)
    for entry in missing:
        if (models / entry.name).is_dir():
            check_writable(models / entry.name)
    missing = [_pinned(entry, models, revision) for entry in missing]
    for entry in missing:
        planned(entry)
    with tempfile.TemporaryDirectory(prefix=".pull-", dir=models) as work:
        for entry in missing:
            _pull_one(entry, models, Path(work), source.parent, report)


def model_state(entry: ModelEntry, models: Path) -> ModelState:
    """Checks the files of an entry in the model directory; reads every file once.

    "unverified": all files are there, but without known digests (put there by hand).
    """
    folder = models / entry.name
    expected = {file.name: file.sha256 for file in entry.files}
    try:
        expected |= read_receipt(folder, name=entry.name).sha256
    except ModelUnavailableError:
        return "damaged"
    present = [name for name in expected if (folder / name).is_file()]
    if len(present) < len(expected):
        # A folder filled by hand may use other file names: adapters look for parts, not names.
        by_hand = folder.is_dir() and any(path.suffix in (".onnx", ".ort", ".npz") for path in folder.iterdir())
        return "damaged" if present else "unverified" if by_hand else "absent"
    if any(digest and file_sha256(folder / name) != digest for name, digest in expected.items()):
        return "damaged"
    return "ready" if all(expected.values()) else "unverified"


def _pinned(entry: ModelEntry, models: Path, revision: str | None) -> ModelEntry:
    try:
        return pinned(entry, _receipt(entry, models), revision)
    except RefusedError as error:
        raise ModelUnavailableError(
            f"model {entry.name} could not be looked up: {error}",
            field=entry.name,
            hint="Check the network and HF_ENDPOINT, or bring a zip of models: fastsplat models use models.zip",
        ) from error


def _receipt(entry: ModelEntry, models: Path) -> Receipt:
    try:
        return read_receipt(models / entry.name, name=entry.name)
    except ModelUnavailableError:  # damaged: nothing of it can be trusted
        return Receipt()


def _is_there(entry: ModelEntry, models: Path, revision: str | None, report: Callable[[Step], None]) -> bool:
    state = model_state(entry, models)
    if revision and any(file["commit"] != revision for file in _receipt(entry, models).hub.values()):
        return False
    if state == "unverified":
        # Put there by hand: kept if it works.
        report(Step(entry.name, "trying out what is there"))
        try:
            check_model(entry, models)
        except ModelUnavailableError:
            return False
    elif state != "ready":
        return False
    report(Step(entry.name, "already there"))
    return True


def check_writable(folder: Path) -> None:
    """Makes a folder if missing; raises `ResourceError` unless models may be put there.

    Read-only marks count for root, too: a folder is marked because others use it unchanged.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        marked = not folder.stat().st_mode & _WRITABLE
    except OSError as error:
        raise ResourceError(
            f"the folder {folder} cannot be made: {error.strerror}", field="models", hint=_ELSEWHERE
        ) from error
    if marked:
        raise ResourceError(f"the folder {folder} is marked read-only", field="models", hint=_ELSEWHERE)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ResourceError(f"the folder {folder} cannot be written", field="models", hint=_ELSEWHERE)


def _pull_one(entry: ModelEntry, models: Path, work: Path, base: Path, report: Callable[[Step], None]) -> None:
    staged = work / "models" / entry.name
    staged.mkdir(parents=True)
    carriers = work / f"{entry.name}-carriers"
    carriers.mkdir()
    conversion = entry.conversion
    jobs = [(file, staged) for file in entry.files if file.sources or conversion is None]
    jobs += [(file, carriers) for file in (conversion.carriers if conversion else ())]
    for file, folder in jobs:
        report(Step(entry.name, f"fetching {file.name}"))

        def on_bytes(done: int, total: int, what: str = file.name) -> None:
            report(Step(entry.name, f"fetching {what}", done, total))

        fetch_file(file, folder / file.name, cache=work, base=base, on_bytes=on_bytes)
    if conversion:
        report(Step(entry.name, f"converting ({conversion.kind})"))
        _convert(conversion, carriers, staged, packages=work / f"{entry.name}-packages", name=entry.name)
    report(Step(entry.name, "trying it out"))
    check_model(entry, work / "models")
    put_in_place(staged, models / entry.name, entry)
    report(Step(entry.name, "ready"))


def put_in_place(staged: Path, target: Path, entry: ModelEntry) -> None:
    """Writes the receipt, flushes a finished folder and renames it to the model's.

    Raises:
        ModelUnavailableError: a file of the model is missing.
        OSError: the disk is full or cannot be written; an earlier model is kept.
    """
    missing = [file.name for file in entry.files if not (staged / file.name).is_file()]
    if missing:
        raise ModelUnavailableError(f"model {entry.name}: its conversion made no {', '.join(missing)}")
    fetched = {
        file.name: {"repo": source.repo, "path": source.path, "commit": source.revision}
        for file in entry.files
        for source in file.sources[:1]
        if isinstance(source, HubSource) and source.revision
    }
    receipt = {
        "model": entry.name,
        "license": entry.license,
        "sha256": {file.name: file_sha256(staged / file.name) for file in entry.files},
        "hub": {**read_receipt(staged, name=entry.name).hub, **fetched},
    }
    (staged / RECEIPT).write_text(json.dumps(receipt, indent=1) + "\n", "utf-8")
    for path in staged.iterdir():
        with path.open("rb") as stream:
            os.fsync(stream.fileno())
    aside = staged.parent / f"{entry.name}-before"
    if target.exists():
        target.rename(aside)  # removed with the temporary folder
    try:
        staged.rename(target)
    except OSError:
        if aside.exists():
            shutil.move(aside, target)
        raise


def _convert(conversion: Conversion, carriers: Path, target: Path, *, packages: Path, name: str) -> None:
    """Converts the files in `carriers` and writes the result to `target`.

    The temporary folder `packages` keeps the conversion's packages out of the product's environment. Raises
    `ModelUnavailableError` with the end of the output if it fails.
    """
    if conversion.packages:
        arguments = ["install", "--no-deps", "--only-binary", ":all:", "--target", str(packages), *conversion.packages]
        try:
            run_pip(arguments)
        except RefusedError as error:
            raise ModelUnavailableError(
                f"model {name}: the packages for its conversion could not be installed: {error}",
                field=name,
                hint="Check the network and the package index.",
            ) from error
    script = Path(__file__).parent / _SCRIPTS[conversion.kind]
    # Scripts append the packages to their search path, so that they shadow none of the product's.
    command = [sys.executable, str(script), str(carriers), str(target), str(packages)]
    # The script's folder must not become importable: it holds modules of the product under bare names.
    environment = {**os.environ, "PYTHONSAFEPATH": "1"}
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False, env=environment)
        failure = done.stderr.strip() if done.returncode else ""
    except subprocess.TimeoutExpired:
        failure = f"no end after {_TIMEOUT_S} s"
    if failure:
        raise ModelUnavailableError(
            f"model {name}: its conversion failed: {' '.join(failure.splitlines()[-3:])[:400]}",
            field=name,
            hint="Convert it elsewhere and put the files into the model directory.",
        )
