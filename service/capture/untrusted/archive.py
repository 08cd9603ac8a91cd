"""Unpacks zip and tar archives within bounds counted while reading; headers are not trusted."""

from __future__ import annotations

import gzip
import io
import stat
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.common.file_names import is_system_file, safe_parts
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, UnsafeArchiveError

_CHUNK = 1 << 20
_RATIO_FREE_BYTES = 4 << 20  # below this the compression ratio is not limited
_DIRECTORY_BYTES_PER_ENTRY = 1_024
_UNSUPPORTED = (".7z", ".rar", ".tar.xz", ".txz", ".tar.bz2", ".tbz2", ".tar.zst", ".gz", ".xz", ".bz2", ".zst")
ARCHIVE_SUFFIXES = (".zip", ".tar", ".tgz", *_UNSUPPORTED)

_DAMAGE = (
    zipfile.BadZipFile,
    tarfile.TarError,
    gzip.BadGzipFile,
    zlib.error,
    struct.error,
    EOFError,
    NotImplementedError,
    ValueError,  # tarfile's, of a sparse map that is none
    OverflowError,
)


def is_archive(path: Path) -> bool:
    """Detects zip, tar or tar.gz by its first bytes; raises `InvalidInputError` for other archives."""
    with path.open("rb") as file:
        head = file.read(512)
    if head.startswith((b"PK\x03\x04", b"PK\x05\x06", b"\x1f\x8b")) or head[257:262] == b"ustar":
        return True
    if path.name.lower().endswith(ARCHIVE_SUFFIXES):
        raise InvalidInputError.of(path.name, "is not a readable archive", "Send a zip, tar or tar.gz file.")
    return False


def unpack(archive: Path, into: Path, settings: CaptureSettings) -> None:
    """Unpacks an archive into an empty folder, without hidden and system files.

    Raises:
        UnsafeArchiveError: an entry leaves its folder, is a link, device or other special file, shares its name or its
            bytes with another, or the archive unpacks to more than `max_compression_ratio` times its size.
        LimitExceededError: more entries or bytes than the settings allow.
        InvalidInputError: the archive is damaged, encrypted, or of an unsupported kind.
    """
    writer = _Writer(archive, into, settings)
    try:
        with archive.open("rb") as file:
            zipped = file.read(2) == b"PK"
        if zipped:
            _unpack_zip(archive, writer, settings)
        elif _is_packed_ply(archive):
            with gzip.open(archive) as stream:
                writer.write(archive.stem, writer.counted(stream.read))
        else:
            _unpack_tar(archive, writer)
    except _DAMAGE as error:
        raise InvalidInputError.of(
            archive.name, f"is damaged or cut short: {error}", "Pack and send it again."
        ) from error


def _is_packed_ply(archive: Path) -> bool:
    with archive.open("rb") as file:
        head = file.read(512)
    return head[:2] == b"\x1f\x8b" and zlib.decompressobj(31).decompress(head, 4).startswith(b"ply")


class _Writer:
    """Writes entries one by one and counts entries and bytes."""

    def __init__(self, archive: Path, into: Path, settings: CaptureSettings) -> None:
        self._archive, self._into, self._settings = archive.name, into, settings
        self._compressed = archive.stat().st_size
        self._names: set[tuple[str, ...]] = set()
        self._folders: set[tuple[str, ...]] = set()
        self._entries = 0
        self._bytes = 0

    def count_entry(self) -> None:
        self._entries += 1
        if self._entries > self._settings.max_entries:
            raise _too_many_entries(self._archive, self._settings)

    def count_bytes(self, size: int) -> None:
        self._bytes += size
        if self._bytes > self._settings.max_unpacked_bytes:
            raise LimitExceededError.of(
                self._archive,
                f"unpacks to more than {self._settings.max_unpacked_bytes} bytes",
                "Send fewer or smaller images.",
                f"{self._settings.max_unpacked_bytes} bytes (FASTSPLAT_CAPTURE__MAX_UNPACKED_BYTES)",
            )
        ratio = self._settings.max_compression_ratio
        if self._bytes > _RATIO_FREE_BYTES and self._bytes > ratio * self._compressed:
            raise UnsafeArchiveError.of(
                self._archive,
                f"unpacks to more than {ratio} times its size, as decompression bombs do",
                "Send the images as they are.",
                f"{ratio} times",
            )

    def write(self, name: str, read: Callable[[int], bytes]) -> None:
        parts = _entry_parts(name, self._archive)
        if parts in self._names:
            raise UnsafeArchiveError(
                f"{self._archive}: two entries are called {name!r}", field=name, hint="Give every file its own name."
            )
        self._names.add(parts)
        for depth in range(1, len(parts)):  # folders cost as much as files, and may be named by their content alone
            if parts[:depth] not in self._folders:
                self._folders.add(parts[:depth])
                self.count_entry()
        if is_system_file(parts):
            return
        target = self._into.joinpath(*parts)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("xb") as file:
                while chunk := read(_CHUNK):
                    file.write(chunk)
        except (FileExistsError, NotADirectoryError, IsADirectoryError) as error:
            raise UnsafeArchiveError(
                f"{self._archive}: {name!r} is a file and a folder at once", field=name, hint="Pack the folder again."
            ) from error

    def counted(self, read: Callable[[int], bytes]) -> Callable[[int], bytes]:
        def counted_read(size: int) -> bytes:
            data = read(size)
            self.count_bytes(len(data))
            return data

        return counted_read


def _unpack_zip(archive: Path, writer: _Writer, settings: CaptureSettings) -> None:
    _check_zip_directory(archive, settings)
    with archive.open("rb") as raw, zipfile.ZipFile(raw) as reader:
        entries = reader.infolist()
        for entry in entries:
            writer.count_entry()
            _check_zip_entry(entry, archive.name)
        _check_zip_overlap(raw, entries, archive.name)
        for entry in entries:
            # The format demands slashes (APPNOTE 4.4.17.1); Windows' Compress-Archive wrote backslashes for years.
            name = entry.filename.replace("\\", "/")
            if entry.is_dir():
                _entry_parts(name, archive.name)
                continue
            with reader.open(entry) as stream:
                writer.write(name, writer.counted(stream.read))


def _check_zip_directory(archive: Path, settings: CaptureSettings) -> None:
    """Bounds the central directory before `zipfile` reads all of it into memory."""
    with archive.open("rb") as file:
        size = file.seek(0, io.SEEK_END)
        tail_at = max(0, size - (1 << 16) - 22)
        file.seek(tail_at)
        tail = file.read()
        at = tail.rfind(b"PK\x05\x06")
        if at < 0 or len(tail) - at < 22:
            raise zipfile.BadZipFile("no central directory")
        directory_bytes = struct.unpack_from("<I", tail, at + 12)[0]
        if directory_bytes == 0xFFFFFFFF:
            directory_bytes = tail_at + at  # zip64: at most what lies before its end
    if directory_bytes > min(settings.max_entries * _DIRECTORY_BYTES_PER_ENTRY, size):
        raise _too_many_entries(archive.name, settings)


def _check_zip_entry(entry: zipfile.ZipInfo, archive: str) -> None:
    mode = entry.external_attr >> 16
    if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise _special(archive, entry.filename)
    if entry.flag_bits & 0x1:
        raise InvalidInputError(
            f"{archive}: {entry.filename!r} is encrypted", field=entry.filename, hint="Send it without a password."
        )
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InvalidInputError(
            f"{archive}: {entry.filename!r} is packed by method {entry.compress_type}",
            field=entry.filename,
            hint="Pack with deflate, every zip program's default.",
        )


def _check_zip_overlap(raw: BinaryIO, entries: list[zipfile.ZipInfo], archive: str) -> None:
    """Refuses shared bytes, with which a small file unpacks to any size (https://www.bamsoftware.com/hacks/zipbomb)."""
    end = 0
    for entry in sorted(entries, key=lambda item: item.header_offset):
        if entry.header_offset < 0:  # zipfile shifts all offsets if the directory is misplaced
            raise zipfile.BadZipFile("the central directory is not where the archive's end says")
        raw.seek(entry.header_offset)
        header = raw.read(30)
        if len(header) < 30 or header[:4] != b"PK\x03\x04":
            raise zipfile.BadZipFile(f"no local header for {entry.filename!r}")
        if entry.header_offset < end:
            raise UnsafeArchiveError(
                f"{archive}: {entry.filename!r} overlaps another entry, as decompression bombs do",
                field=entry.filename,
                hint="Pack the folder again.",
            )
        name_bytes, extra_bytes = struct.unpack_from("<HH", header, 26)
        end = entry.header_offset + 30 + name_bytes + extra_bytes + entry.compress_size


def _unpack_tar(archive: Path, writer: _Writer) -> None:
    with archive.open("rb") as raw:
        compressed = raw.read(2) == b"\x1f\x8b"
        raw.seek(0)
        source: BinaryIO = gzip.GzipFile(fileobj=raw) if compressed else raw  # type: ignore[assignment]  # it can read
        forward = _Forward(source, archive.name, writer.count_bytes)
        with tarfile.TarFile(fileobj=forward, mode="r") as reader:  # type: ignore[arg-type]  # it only reads
            for member in reader:
                writer.count_entry()
                if member.isdir():
                    if member.name != ".":
                        _entry_parts(member.name, archive.name)
                    continue
                stream = reader.extractfile(member) if member.isreg() and not member.issparse() else None
                if stream is None:
                    raise _special(archive.name, member.name)
                writer.write(member.name, stream.read)


class _Forward:
    """A forward-only stream that counts bytes and refuses large single reads, as of forged headers."""

    def __init__(self, source: BinaryIO, archive: str, count: Callable[[int], None]) -> None:
        self._source, self._archive, self._count = source, archive, count
        self._at = 0

    def read(self, size: int) -> bytes:
        if size > _CHUNK:
            raise UnsafeArchiveError.of(
                self._archive,
                f"has an extended header of {size} bytes",
                "Pack the folder again without extended attributes.",
                f"{_CHUNK} bytes",
            )
        data = self._source.read(size)
        self._at += len(data)
        self._count(len(data))
        return data

    def tell(self) -> int:
        return self._at

    def seek(self, position: int) -> int:
        if position < self._at:
            raise tarfile.ReadError("the archive points backwards")
        while self._at < position and self.read(min(_CHUNK, position - self._at)):
            pass
        return self._at


def _entry_parts(name: str, archive: str) -> tuple[str, ...]:
    try:
        return safe_parts(name)
    except InvalidInputError as error:
        raise UnsafeArchiveError(
            f"{archive}: {error.message}",
            field=repr(name[:80])[1:-1],
            hint="Pack the folder again, with relative names below it.",
        ) from error


def _special(archive: str, name: str) -> UnsafeArchiveError:
    return UnsafeArchiveError(
        f"{archive}: {name!r} is a link, a device or another special file",
        field=name,
        hint="Pack plain files only; replace links by what they point to.",
    )


def _too_many_entries(archive: str, settings: CaptureSettings) -> LimitExceededError:
    return LimitExceededError.of(
        archive,
        f"has more than {settings.max_entries} entries",
        "Send fewer images.",
        f"{settings.max_entries} entries",
    )
