"""Static files of this release, with compression and cache headers."""

from __future__ import annotations

import gzip
import os
from functools import cache
from pathlib import Path

from starlette.datastructures import Headers
from starlette.responses import FileResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from fastsplat.api.rest.standard_http import reads_gzip

_COMPRESSED_TYPES = {"text/html", "text/css", "text/javascript", "application/javascript", "image/svg+xml"}


class ReleaseFiles(StaticFiles):
    """Files of a folder, which may be missing; browsers revalidate them, as releases reuse names.

    Files in the subfolder `immutable` have a content hash in their names and are not revalidated.
    """

    def __init__(self, folder: Path, immutable: str = "") -> None:
        super().__init__(directory=folder, check_dir=False)
        self._immutable = folder / immutable if immutable else None

    async def check_config(self) -> None:
        """Accepts a missing folder."""

    def file_response(
        self, full_path: str | os.PathLike[str], stat_result: os.stat_result, scope: Scope, status_code: int = 200
    ) -> Response:
        response = super().file_response(full_path, stat_result, scope, status_code)
        etag = response.headers["etag"]
        path = Path(full_path)
        is_immutable = self._immutable is not None and path.is_relative_to(self._immutable.resolve())
        # Weak: the same tag for the plain and the compressed file.
        headers = {
            "Cache-Control": "public, max-age=31536000, immutable" if is_immutable else "no-cache",
            "Vary": "Accept-Encoding",
            "ETag": f"W/{etag}",
        }
        response.headers.update(headers)
        if not isinstance(response, FileResponse) or response.media_type not in _COMPRESSED_TYPES:
            return response
        request_headers = Headers(scope=scope)
        if not reads_gzip(request_headers) or "range" in request_headers:
            return response
        content = _compressed(path, etag)
        return Response(content, status_code, {**headers, "Content-Encoding": "gzip"}, response.media_type)


@cache
def _compressed(path: Path, etag: str) -> bytes:
    """Compresses a file; the cache is unbounded because a release has few."""
    return gzip.compress(path.read_bytes(), mtime=0)
