"""Untrusted archives: what is unpacked lies below the folder, and nothing else happens."""

from __future__ import annotations

import io
import struct
import tarfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from PIL import Image

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.untrusted.archive import unpack
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, UnsafeArchiveError
from tests.capture.upload_files import encoded, photo_file


def _zip(entries: Sequence[tuple[str, bytes]], **attributes: int) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries:
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            for key, value in attributes.items():
                setattr(info, key, value)
            archive.writestr(info, content)
    return stream.getvalue()


def _tar(entries: Sequence[tuple[str | tarfile.TarInfo, bytes]], mode: str = "w") -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode=mode) as archive:
        for entry, content in entries:
            info = _member(entry) if isinstance(entry, str) else entry
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    return stream.getvalue()


def _member(name: str, kind: bytes = tarfile.REGTYPE, target: str = "") -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, target
    return info


def _packed(form: str, entries: Sequence[tuple[str, bytes]]) -> bytes:
    return _zip(entries) if form == "zip" else _tar(entries, "w:gz" if form == "tar.gz" else "w")


def _overwritten(packed: bytes, *numbers: tuple[int, int]) -> bytes:
    """With these 32-bit numbers at these places."""
    changed = bytearray(packed)
    for place, number in numbers:
        struct.pack_into("<I", changed, place, number)
    return bytes(changed)


def _extended_header(size: int) -> bytes:
    header = _member("././@PaxHeader", tarfile.XHDTYPE)
    header.size = size
    return header.tobuf(tarfile.USTAR_FORMAT) + bytes(1024)


def _trick(kind: bytes) -> bytes:
    return _tar([(_member("trick", kind, "/etc/passwd"), b"")])


def _sparse(name: str) -> tarfile.TarInfo:
    member = _member(name)
    numbers = {"major": "1", "minor": "0", "name": "x", "realsize": "1000"}
    member.pax_headers = {f"GNU.sparse.{key}": value for key, value in numbers.items()}
    return member


@pytest.mark.parametrize(("form", "between"), [("zip", "/"), ("zip", "\\"), ("tar", "/"), ("tar.gz", "/")])
def test_archive_and_loose_files_are_the_same_upload(form, between, upload, photo, settings) -> None:
    """Zips of Windows have backslashes between folders."""
    files = {"set/a.jpg": photo(1), "set/b.jpg": photo(2)}
    junk = [("__MACOSX/set/._a.jpg", b"x"), ("set/.DS_Store", b"x"), ("Thumbs.db", b"x")] if form == "zip" else []
    entries = [(name.replace("/", between), content) for name, content in files.items()]
    validated = validate_upload(upload({f"photos.{form}": _packed(form, [*entries, *junk])}), settings)
    assert (validated.source, validated.images) == ("images", 2)
    root = validated.folder / "files"
    assert {path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()} == set(files)


_A, _B = ("a.jpg", photo_file(1)), ("b.jpg", photo_file(2))
_PAIR, _BOMB = _zip([_A, _B]), _zip([("zeros.jpg", bytes(16 << 20))])
_RECORD, _END = b"PK\x01\x02", b"PK\x05\x06"
_SMALL_BOMB = _overwritten(_BOMB, (22, 10), (_BOMB.rfind(_RECORD) + 24, 10))
_OVERLAPPING = _overwritten(_PAIR, (_PAIR.rfind(_RECORD) + 42, 0))
_ELSEWHERE = _overwritten(_PAIR, (_PAIR.rfind(_END) + 16, len(_PAIR) + 1_000))
_LINK = _zip([("trick.jpg", b"/etc/passwd")], external_attr=0o120777 << 16)
_LEAVING = ("../evil.jpg", "a/../../evil.jpg", "/etc/evil.jpg", "C:/evil.jpg", "..\\evil.jpg")
_NO_FILES = (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.BLKTYPE, tarfile.FIFOTYPE)
_ENTRIES = [(f"{number}.txt", b"") for number in range(201)]
_DEEP = [(f"{number}/a/b/c/d/e/f/g/h/i/j/a.txt", b"") for number in range(20)]
_REFUSED = {
    "backslash in a tar": ("tar", _tar([_A, ("set\\b.jpg", b"x")]), UnsafeArchiveError, "backslash"),
    **{
        f"{name} in a {form}": (form, _packed(form, [_A, (name, b"x")]), UnsafeArchiveError, "evil.jpg")
        for form in ("zip", "tar")
        for name in _LEAVING
    },
    **{f"member of kind {kind!r}": ("tar", _trick(kind), UnsafeArchiveError, "trick") for kind in _NO_FILES},
    "link in a zip": ("zip", _LINK, UnsafeArchiveError, "trick.jpg"),
    "two entries of one name": ("zip", _zip([_A, ("./a.jpg", b"x")]), UnsafeArchiveError, "a.jpg"),
    "file that is a folder too": ("zip", _zip([("a", b"x"), ("a/b.jpg", b"x")]), UnsafeArchiveError, "a/b.jpg"),
    "bomb": ("zip", _BOMB, UnsafeArchiveError, " times"),
    "bomb in a tar": ("tar.gz", _tar([("zeros.jpg", bytes(16 << 20))], "w:gz"), UnsafeArchiveError, " times"),
    "bomb whose headers say 10 bytes": ("zip", _SMALL_BOMB, InvalidInputError, "photos.zip"),
    "entries that overlap": ("zip", _OVERLAPPING, UnsafeArchiveError, "overlaps"),
    "many entries": ("zip", _zip(_ENTRIES), LimitExceededError, " entries"),
    "many entries in a tar": ("tar", _tar(_ENTRIES), LimitExceededError, " entries"),
    "many folders": ("zip", _zip([*_DEEP, _A, _B]), LimitExceededError, " entries"),
    "extended header of gigabytes": ("tar", _extended_header(4 << 30), UnsafeArchiveError, "photos.tar"),
    "cut short": ("zip", _PAIR[: len(_PAIR) // 2], InvalidInputError, "photos.zip"),
    "tar cut short": ("tar.gz", _tar([_A, _B], "w:gz")[:1_000], InvalidInputError, "photos.tar.gz"),
    "directory elsewhere": ("zip", _ELSEWHERE, InvalidInputError, "photos.zip"),
    "sparse photo": ("tar", _tar([(_sparse("a.jpg"), _A[1]), _B]), InvalidInputError, "photos.tar"),
    "unsupported kind": ("7z", b"7z\xbc\xaf\x27\x1c" + bytes(600), InvalidInputError, "photos.7z"),
}


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("case", _REFUSED)
def test_an_archive_that_is_not_what_it_says_is_refused(case: str, refuses) -> None:
    form, packed, kind, text = _REFUSED[case]
    refuses({f"photos.{form}": packed}, kind, text)


def test_too_many_bytes(refuses) -> None:
    limits = {"max_unpacked_bytes": 1000, "max_compression_ratio": 10**9}
    refuses({"photos.zip": _zip([("a.jpg", bytes(2000))])}, LimitExceededError, "MAX_UNPACKED_BYTES", **limits)


def test_images_of_far_more_pixels_than_bytes_are_refused_before_they_are_decoded(
    upload, settings, refused, monkeypatch
) -> None:
    black = encoded(Image.new("L", (8000, 8000)))
    folder = upload({"photos.zip": _zip([(f"{number}.png", black) for number in range(5)])})
    allowed = settings.model_copy(update={"max_compression_ratio": 10**9})
    monkeypatch.setattr(Image.Image, "load", lambda image: pytest.fail("it was decoded"))
    with refused(LimitExceededError, "pixels a byte"):
        validate_upload(folder, allowed)


def test_more_pixels_than_an_upload_may_have(photo, refuses) -> None:
    files = {f"{number}.jpg": photo(number) for number in range(3)}
    refuses(files, LimitExceededError, "6144 pixels", max_pixels=64 * 48 * 2)


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
    (place / "it").write_bytes(_packed("tar" if tar else "zip", entries))
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
