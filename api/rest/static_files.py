"""Static files of this release over HTTP: compressed, and cached by browsers as long as they are right."""

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
    """Files of a folder. The next release has others under the same names, so a browser asks whether its copy holds.

    Args:
        folder: where they are; without it there are no files.
        immutable: a folder in it whose files have their content's hash in their names: a browser never asks again.
    """

    def __init__(self, folder: Path, immutable: str = "") -> None:
        super().__init__(directory=folder, check_dir=False)
        self._immutable = folder / immutable if immutable else None

    async def check_config(self) -> None:
        """Nothing: a folder that is not there is no fault of the server."""

    def file_response(
        self, full_path: str | os.PathLike[str], stat_result: os.stat_result, scope: Scope, status_code: int = 200
    ) -> Response:
        """The file, compressed where the browser reads that."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        etag = response.headers["etag"]
        path = Path(full_path)
        is_immutable = self._immutable is not None and path.is_relative_to(self._immutable.resolve())
        # Weak: one tag for the file as it is and compressed.
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
    """A file of this release, of which there are few."""
    return gzip.compress(path.read_bytes(), mtime=0)
