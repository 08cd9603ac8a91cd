"""Strangers' pictures are decoded in the confined child alone, to the same pixels, and its end is a typed error."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.image_io import PhotoInfo, check_image, load_upright
from fastsplat.service.capture.formats.reduced_images import reduce
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.untrusted.confinement import missing_protections
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder
from fastsplat.service.capture.untrusted.image_decoding import load_upright_map
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import CorruptImageError, InvalidInputError, LimitExceededError, ResourceError
from tests.capture.upload_files import turned
from tests.small_tabletop import small_tabletop

SIZE = (33, 24)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    folder = tmp_path / "files"
    folder.mkdir()
    pixels = np.random.default_rng(5).integers(0, 255, (48, 66, 4), dtype=np.uint8)
    Image.fromarray(pixels[..., :3]).save(folder / "turned.jpg", exif=turned(6))
    Image.fromarray(pixels).save(folder / "clear.png")
    Image.fromarray(pixels[..., 0].astype(np.uint16) * 250).save(folder / "ids.png")
    return folder


@pytest.fixture
def decoder(tmp_path: Path, root: Path) -> Iterator[ImageDecoder]:
    folder = tmp_path / "own"
    folder.mkdir()
    with ImageDecoder(folder, [root], CaptureSettings()) as opened:
        yield opened


def _info(name: str, width: int = 66, height: int = 48) -> PhotoInfo:
    return PhotoInfo(name, width, height, 1, "", 0.0)


def test_the_child_decodes_to_the_pixels_of_this_process(decoder: ImageDecoder, root: Path) -> None:
    settings = CaptureSettings()
    for name, size in (("turned.jpg", SIZE[::-1]), ("clear.png", SIZE), ("clear.png", (66, 48))):
        photo = check_image(root, name, settings)
        expected = reduce(load_upright(root, photo, settings), size)
        np.testing.assert_array_equal(decoder.photo(root, photo, size), expected)
    for photo, size in ((_info("x"), SIZE), (PhotoInfo("x", 66, 48, 6, "", 0.0), SIZE[::-1])):
        expected_ids = load_upright_map(root, "ids.png", photo, size, settings)
        ids = decoder.ids(root, "ids.png", photo, size)
        assert ids.max() > 255
        np.testing.assert_array_equal(ids, expected_ids)


def test_a_bad_picture_is_refused_by_name_and_the_next_is_decoded(tmp_path: Path, root: Path) -> None:
    (root / "cut.jpg").write_bytes((root / "turned.jpg").read_bytes()[:900])
    folder = tmp_path / "own"
    folder.mkdir()
    with ImageDecoder(folder, [root], CaptureSettings(max_image_pixels=66 * 48)) as decoder:
        with pytest.raises(CorruptImageError, match=r"cut\.jpg"):
            decoder.photo(root, _info("cut.jpg"), SIZE)
        with pytest.raises(InvalidInputError, match="colors"):
            decoder.ids(root, "turned.jpg", _info("turned.jpg"), SIZE)
        Image.new("RGB", (67, 48)).save(root / "large.png")
        with pytest.raises(LimitExceededError):
            decoder.photo(root, _info("large.png"), SIZE)
        assert decoder.photo(root, _info("clear.png"), SIZE).shape == (24, 33, 3)


def test_it_reads_nothing_outside_its_folders(decoder: ImageDecoder, tmp_path: Path, root: Path) -> None:
    if any(line.startswith("Landlock") for line in missing_protections()):
        pytest.skip("no Landlock here")
    Image.new("RGB", (66, 48)).save(tmp_path / "secret.png")
    os.symlink(tmp_path / "secret.png", root / "link.png")
    for name in ("../secret.png", "link.png"):
        with pytest.raises(CorruptImageError):
            decoder.photo(root, _info(name), SIZE)


def test_a_child_that_hangs_or_dies_is_a_typed_error(tmp_path: Path, root: Path) -> None:
    os.mkfifo(root / "never.png")
    for number, ending in enumerate((False, True)):
        folder = tmp_path / f"own{number}"
        folder.mkdir()
        with ImageDecoder(folder, [root], CaptureSettings(validation_seconds=1)) as decoder:
            if ending:
                decoder._process.kill()
            with pytest.raises(ResourceError) as caught:
                decoder.photo(root, _info("never.png"), SIZE)
            assert (caught.value.limit == "1 s") is not ending
        assert decoder._process.poll() is not None


def test_this_process_decodes_nothing_that_a_stranger_sent(
    tmp_path: Path, test_data: Path, settings: CaptureSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    upload = small_tabletop(test_data, tmp_path / "upload", 3)
    validated = validate_upload(upload, settings)
    opened: list[str] = []
    original = Image.open

    def recording(source: Any, *arguments: Any, **more: Any) -> Image.Image:
        opened.append(str(source))
        return original(source, *arguments, **more)

    monkeypatch.setattr(Image, "open", recording)
    capture = build_capture(validated.folder, tmp_path / "capture", settings, silent)
    assert len(capture.views) == 3
    assert not [path for path in opened if str(upload) in path]


@pytest.mark.parametrize("name", ["../key", "/etc/passwd"])
def test_what_a_taken_over_validation_left_does_not_lead_elsewhere(
    name: str, tmp_path: Path, root: Path, settings: CaptureSettings
) -> None:
    upload = tmp_path / "upload"
    upload.mkdir()
    for number in range(2):
        Image.new("RGB", (64, 48), (number, 0, 0)).save(upload / f"{number}.png")
    folder = validate_upload(upload, settings).folder
    read_manifest(folder)
    (folder / "files" / "link.json").symlink_to("/etc/passwd")
    with pytest.raises(InvalidInputError, match=r"link\.json"):
        read_manifest(folder)
    (folder / "files" / "link.json").unlink()
    stored = json.loads((folder / "validated.json").read_text())
    (folder / "validated.json").write_text(json.dumps({**stored, "video": name}))
    with pytest.raises(InvalidInputError, match="leads to other files"):
        read_manifest(folder)
