"""Small real uploads, and the law every refusal obeys: a typed error, and nothing left behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat_contract.errors import FastSplatError
from tests.capture.upload_files import photo_file

Upload = Callable[[dict[str, bytes]], Path]
Refused = Callable[..., AbstractContextManager[None]]


@pytest.fixture
def settings() -> CaptureSettings:
    return CaptureSettings(max_unpacked_bytes=64 << 20, max_entries=200, sfm_threads=2)


@pytest.fixture
def upload(tmp_path: Path) -> Upload:
    def write(files: dict[str, bytes]) -> Path:
        folder = tmp_path / "place" / "upload"
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return folder

    return write


@pytest.fixture
def refused(tmp_path: Path) -> Refused:
    """A block that must raise `kind`, mention all of `texts`, give a hint, and leave the disk as it was."""

    @contextmanager
    def check(kind: type[FastSplatError], *texts: str) -> Iterator[None]:
        before = sorted(tmp_path.rglob("*"))
        with pytest.raises(kind) as caught:
            yield
        error = caught.value
        text = " ".join([error.message, error.field, error.limit])
        assert type(error) is kind
        for part in texts:
            assert part in text
        assert error.hint
        assert sorted(tmp_path.rglob("*")) == before

    return check


@pytest.fixture
def refuses(upload: Upload, refused: Refused, settings: CaptureSettings) -> Callable[..., None]:
    """Sends files, which the check of uploads must refuse with `kind` and all of `texts`."""

    def check(
        files: dict[str, bytes], kind: type[FastSplatError], *texts: str, strict: bool = False, **changes: object
    ) -> None:
        folder = upload(files)
        with refused(kind, *texts):
            validate_upload(folder, settings.model_copy(update=changes), strict=strict)

    return check


@pytest.fixture
def photo() -> Callable[..., bytes]:
    return photo_file
