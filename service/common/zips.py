"""Zip archives in memory."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from io import BytesIO

_DATE = (1980, 1, 1, 0, 0, 0)
"""The earliest that a zip knows: the same files are the same bytes."""


def zipped(files: Mapping[str, bytes], *, compressed: bool = True) -> bytes:
    """A zip of the files by their names, in their order; the same bytes for the same files.

    Args:
        files: the content of each.
        compressed: deflate them; files that are compressed already are better stored as they are.
    """
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    file = BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, _DATE), content, method)
    return file.getvalue()
