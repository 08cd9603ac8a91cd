"""Untrusted archives: what is unpacked lies below the folder, and nothing else happens."""

from __future__ import annotations

import io
import struct
import tarfile
import zipfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from PIL import Image

from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.untrusted.archive import unpack
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, UnsafeArchiveError


def _zip(entries: list[tuple[str, bytes]], **attributes: int) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries:
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            for key, value in attributes.items():
                setattr(info, key, value)
            archive.writestr(info, content)
    return stream.getvalue()


def _tar(members: list[tuple[tarfile.TarInfo, bytes]], mode: str = "w") -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode=mode) as archive:
        for info, content in members:
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    return stream.getvalue()


def _member(name: str, kind: bytes = tarfile.REGTYPE, target: str = "") -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, target
    return info


@pytest.mark.parametrize("form", ["zip", "tar", "tar.gz"])
def test_archive_and_loose_files_are_the_same_upload(form, upload, photo, settings) -> None:
    files = {"set/a.jpg": photo(1), "set/b.jpg": photo(2)}
    if form == "zip":
        packed = _zip([*files.items(), ("__MACOSX/set/._a.jpg", b"x"), ("set/.DS_Store", b"x"), ("Thumbs.db", b"x")])
    else:
        members = [(_member(name), content) for name, content in files.items()]
        packed = _tar(members, "w" if form == "tar" else "w:gz")
    validated = validate_upload(upload({f"photos.{form}": packed}), settings)
    assert (validated.source, validated.images) == ("images", 2)
    root = validated.folder / "files"
    assert {path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()} == set(files)


def test_backslashes_of_a_zip_made_by_windows_are_folders(upload, photo, settings) -> None:
    folder = upload({"photos.zip": _zip([("set\\a.jpg", photo(1)), ("set\\b.jpg", photo(2))])})
    root = validate_upload(folder, settings).folder / "files"
    assert {path.relative_to(root).as_posix() for path in root.rglob("*.jpg")} == {"set/a.jpg", "set/b.jpg"}


def test_backslashes_in_a_tar_are_refused(upload, photo, settings, refused) -> None:
    folder = upload({"photos.tar": _tar([(_member("a.jpg"), photo(1)), (_member("set\\b.jpg"), photo(2))])})
    with refused(UnsafeArchiveError, "photos.tar", "b.jpg", "backslash"):
        validate_upload(folder, settings)


@pytest.mark.parametrize("name", ["../evil.jpg", "a/../../evil.jpg", "/etc/evil.jpg", "C:/evil.jpg", "..\\evil.jpg"])
@pytest.mark.parametrize("form", ["zip", "tar"])
def test_paths_that_leave_the_folder(name, form, upload, photo, settings, refused) -> None:
    entries = [("a.jpg", photo(1)), (name, photo(2))]
    packed = _zip(entries) if form == "zip" else _tar([(_member(n), c) for n, c in entries])
    folder = upload({f"photos.{form}": packed})
    with refused(UnsafeArchiveError, "evil.jpg"):
        validate_upload(folder, settings)


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.BLKTYPE, tarfile.FIFOTYPE])
def test_links_and_devices_in_a_tar(kind, upload, photo, settings, refused) -> None:
    packed = _tar([(_member("a.jpg"), photo(1)), (_member("trick", kind, "/etc/passwd"), b"")])
    folder = upload({"photos.tar": packed})
    with refused(UnsafeArchiveError, "trick"):
        validate_upload(folder, settings)


def test_link_in_a_zip(upload, settings, refused) -> None:
    folder = upload({"photos.zip": _zip([("trick.jpg", b"/etc/passwd")], external_attr=0o120777 << 16)})
    with refused(UnsafeArchiveError, "trick.jpg"):
        validate_upload(folder, settings)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_entries_of_one_name(upload, photo, settings, refused) -> None:
    folder = upload({"photos.zip": _zip([("a.jpg", photo(1)), ("./a.jpg", photo(2))])})
    with refused(UnsafeArchiveError, "a.jpg"):
        validate_upload(folder, settings)


def test_a_file_that_is_a_folder_too(upload, photo, settings, refused) -> None:
    folder = upload({"photos.zip": _zip([("a", b"x"), ("a/b.jpg", photo(2))])})
    with refused(UnsafeArchiveError, "a/b.jpg"):
        validate_upload(folder, settings)


@pytest.mark.parametrize("form", ["zip", "tar.gz"])
def test_bomb(form, upload, settings, refused) -> None:
    zeros = bytes(16 << 20)
    packed = _zip([("zeros.jpg", zeros)]) if form == "zip" else _tar([(_member("zeros.jpg"), zeros)], "w:gz")
    folder = upload({f"photos.{form}": packed})
    with refused(UnsafeArchiveError, " times"):
        validate_upload(folder, settings)


def test_bomb_behind_a_lying_header(upload, settings, refused) -> None:
    """The sizes in zip headers are claims; here they say 10 bytes."""
    packed = bytearray(_zip([("zeros.jpg", bytes(16 << 20))]))
    central = packed.rfind(b"PK\x01\x02")
    struct.pack_into("<I", packed, 22, 10)
    struct.pack_into("<I", packed, central + 24, 10)
    folder = upload({"photos.zip": bytes(packed)})
    with refused(InvalidInputError):
        validate_upload(folder, settings)


def test_overlapping_entries(upload, photo, settings, refused) -> None:
    """Two directory records that point to one file's bytes."""
    packed = bytearray(_zip([("a.jpg", photo(1)), ("b.jpg", photo(1))]))
    second = packed.rfind(b"PK\x01\x02")
    struct.pack_into("<I", packed, second + 42, 0)
    folder = upload({"photos.zip": bytes(packed)})
    with refused(UnsafeArchiveError, "overlaps"):
        validate_upload(folder, settings)


@pytest.mark.parametrize("form", ["zip", "tar"])
def test_too_many_entries(form, upload, settings, refused) -> None:
    entries = [(f"{i}.txt", b"") for i in range(settings.max_entries + 1)]
    packed = _zip(entries) if form == "zip" else _tar([(_member(n), c) for n, c in entries])
    folder = upload({f"photos.{form}": packed})
    with refused(LimitExceededError, " entries"):
        validate_upload(folder, settings)


def test_too_many_bytes(upload, settings, refused) -> None:
    small = settings.model_copy(update={"max_unpacked_bytes": 1000, "max_compression_ratio": 10**9})
    folder = upload({"photos.zip": _zip([("a.jpg", bytes(2000))])})
    with refused(LimitExceededError, "MAX_UNPACKED_BYTES"):
        validate_upload(folder, small)


def test_an_extended_header_that_claims_gigabytes(upload, settings, refused) -> None:
    header = _member("././@PaxHeader", tarfile.XHDTYPE)
    header.size = 4 << 30
    folder = upload({"photos.tar": header.tobuf(tarfile.USTAR_FORMAT) + bytes(1024)})
    with refused(UnsafeArchiveError, "photos.tar"):
        validate_upload(folder, settings)


@pytest.mark.parametrize("form", ["zip", "tar.gz"])
def test_cut_short(form, upload, photo, settings, refused) -> None:
    members = [("a.jpg", photo(1, (256, 256))), ("b.jpg", photo(2, (256, 256)))]
    packed = _zip(members) if form == "zip" else _tar([(_member(n), c) for n, c in members], "w:gz")
    folder = upload({f"photos.{form}": packed[: len(packed) // 2]})
    with refused(InvalidInputError, "photos"):
        validate_upload(folder, settings)


def test_a_directory_that_is_not_where_the_archives_end_says(upload, photo, settings, refused) -> None:
    packed = bytearray(_zip([("a.jpg", photo(1)), ("b.jpg", photo(2))]))
    end = packed.rfind(b"PK\x05\x06")
    struct.pack_into("<I", packed, end + 16, struct.unpack_from("<I", packed, end + 16)[0] + 1000)
    folder = upload({"photos.zip": bytes(packed)})
    with refused(InvalidInputError, "photos.zip"):
        validate_upload(folder, settings)


def test_a_tar_that_calls_a_photo_sparse(upload, photo, settings, refused) -> None:
    member = _member("a.jpg")
    sparse = {"major": "1", "minor": "0", "name": "x", "realsize": "1000"}
    member.pax_headers = {f"GNU.sparse.{name}": value for name, value in sparse.items()}
    folder = upload({"photos.tar": _tar([(member, photo(1)), (_member("b.jpg"), photo(2))])})
    with refused(InvalidInputError, "photos.tar"):
        validate_upload(folder, settings)


def test_folders_count_as_entries(upload, photo, settings, refused) -> None:
    deep = "/".join("abcdefghij")
    entries = [(f"{number}/{deep}/a.txt", b"") for number in range(settings.max_entries // 10)]
    folder = upload({"photos.zip": _zip([*entries, ("a.jpg", photo(1)), ("b.jpg", photo(2))])})
    with refused(LimitExceededError, " entries"):
        validate_upload(folder, settings)


def test_images_of_far_more_pixels_than_bytes_are_refused_before_they_are_decoded(
    upload, settings, refused, monkeypatch
) -> None:
    black = io.BytesIO()
    Image.new("L", (8000, 8000)).save(black, "PNG")
    folder = upload({"photos.zip": _zip([(f"{number}.png", black.getvalue()) for number in range(5)])})
    allowed = settings.model_copy(update={"max_compression_ratio": 10**9})
    monkeypatch.setattr(Image.Image, "load", lambda image: pytest.fail("it was decoded"))
    with refused(LimitExceededError, "pixels a byte"):
        validate_upload(folder, allowed)


def test_more_pixels_than_an_upload_may_have(upload, photo, settings, refused) -> None:
    folder = upload({f"{number}.jpg": photo(number) for number in range(3)})
    with refused(LimitExceededError, "6144 pixels"):
        validate_upload(folder, settings.model_copy(update={"max_pixels": 64 * 48 * 2}))


def test_unsupported_kind(upload, settings, refused) -> None:
    folder = upload({"photos.7z": b"7z\xbc\xaf\x27\x1c" + bytes(600)})
    with refused(InvalidInputError, "photos.7z"):
        validate_upload(folder, settings)


_NAMES = st.lists(
    st.text(st.sampled_from("a.b/\\ :é\u202e\x01"), min_size=1, max_size=12).filter(lambda name: name != "."),
    min_size=1,
    max_size=4,
)


@given(names=_NAMES, tar=st.booleans())
@hypothesis_settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_whatever_the_names_nothing_lands_outside(names: list[str], tar: bool, tmp_path_factory) -> None:
    place: Path = tmp_path_factory.mktemp("names")
    entries = [(name, b"content") for name in names]
    (place / "it").write_bytes(_tar([(_member(n), c) for n, c in entries]) if tar else _zip(entries))
    into = place / "into" / "deep"
    into.mkdir(parents=True)
    try:
        unpack(place / "it", into, CaptureSettings())
    except InvalidInputError:
        pass
    else:
        assert all(path.read_bytes() == b"content" for path in into.rglob("*") if path.is_file())
    outside = {path for path in place.rglob("*") if not path.is_relative_to(into)}
    assert outside == {place / "it", place / "into"}
