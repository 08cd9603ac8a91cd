"""Trained scenes as artefacts: trained once, and read by all tests until something that makes them changes."""

from __future__ import annotations

import fcntl
import hashlib
import inspect
import shutil
import tempfile
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

import pytest

import fastsplat
from fastsplat.service.settings import load_settings
from fastsplat_contract.codec.json_codec import to_json
from fastsplat_contract.jobs.operations import Operation
from tests.processes import processes_with
from tests.small_tabletop import small_tabletop

_ROOT = Path(__file__).parent.parent
_FOLDER = _ROOT / ".pytest_cache" / "trained"
_SOURCES = (_ROOT / "service", _ROOT / "workers", _ROOT / "client" / "fastsplat_contract", _ROOT / "constraints.txt")
_READERS = {"localization", "query"}  # rooms of `service` that read scenes and make none
_SUFFIXES = {".py", ".cpp", ".h", ".txt", ".json"}


def trained(name: str, make: Callable[[Path], None], *inputs: Path, folder: Path = _FOLDER) -> Path:
    """A folder with what `make` trains, made where it is not there yet. It is shared: whoever changes it copies it."""
    digest = hashlib.sha256(_digest_of_product().encode())
    for path in (Path(inspect.getfile(make)), *inputs):
        digest.update(_digest(_files(path)).encode())
    target = folder / f"{name}-{digest.hexdigest()[:20]}"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # processes of a test run wait for the one that trains
        if not target.is_dir():
            for old in folder.glob(f"{name}-*"):
                shutil.rmtree(old)
            with tempfile.TemporaryDirectory(dir=folder) as work:
                staging = Path(work) / "made"
                staging.mkdir()
                make(staging)
                staging.rename(target)
    return target


def trained_tabletop(test_data: Path, models: Path) -> Path:
    """Trains a small labelled capture; returns a folder with `table top` (capture), `scene` and `progress.jsonl`."""

    def make(folder: Path) -> None:
        capture, operations = small_tabletop(test_data, folder / "table top", 8), list[Operation]()
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("FASTSPLAT_TRAINING", '{"iterations": 150, "time_budget_s": null, "max_side": 120}')
            patch.setenv("FASTSPLAT_JOBS", '{"niceness": 0}')
            patch.setenv("FASTSPLAT_MODELS", str(models))
            load_settings.cache_clear()
            with fastsplat.train(capture, folder / "scene", max_gaussians=6000, progress=operations.append) as scene:
                assert scene.info.state == "READY"
        load_settings.cache_clear()
        assert processes_with("FASTSPLAT_DATA_DIR", folder / "scene") == []
        (folder / "progress.jsonl").write_bytes(b"".join(to_json(operation) + b"\n" for operation in operations))

    return trained("tabletop", make, test_data / "tabletop")


@cache
def _digest_of_product() -> str:
    files = (path for source in _SOURCES for path in _files(source))
    return _digest(
        path for path in files if path.suffix in _SUFFIXES and not _READERS & set(path.relative_to(_ROOT).parts[1:2])
    )


def _files(path: Path) -> Iterable[Path]:
    return [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())


def _digest(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in files:
        digest.update(f"{path} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()
