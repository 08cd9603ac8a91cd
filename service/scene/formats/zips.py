"""In-memory zip archives."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from io import BytesIO

_DATE = (1980, 1, 1, 0, 0, 0)  # earliest zip date; constant for reproducible bytes


def zipped(files: Mapping[str, bytes], *, compressed: bool = True) -> bytes:
    """Zips files in order, reproducibly; store already compressed files uncompressed."""
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    file = BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, _DATE), content, method)
    return file.getvalue()
