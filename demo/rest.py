"""The demonstration's REST calls: plain HTTP, as any script would make them."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx

_IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp"}
Json = dict[str, Any]


class Refused(SystemExit):
    """The server said no; the message is its own problem report."""


class Rest:
    """One server's REST face."""

    def __init__(self, port: int, key: str) -> None:
        self._http = httpx.Client(
            base_url=f"http://127.0.0.1:{port}",
            headers={"Authorization": f"Bearer {key}"},
            timeout=httpx.Timeout(120.0),
        )

    def close(self) -> None:
        self._http.close()

    def post_capture(self, capture: Path, *, name: str, fields: Json) -> Json:
        """Upload a folder of images, an archive or a video; returns the operation."""
        with ExitStack() as files:
            parts = [
                (field, (sent_as, files.enter_context(path.open("rb")), "application/octet-stream"))
                for field, sent_as, path in _parts(capture)
            ]
            data = {"name": name, "request_id": uuid.uuid4().hex, **fields}
            return _body(self._http.post("/v1/scenes", data=data, files=parts, timeout=600.0))

    def follow(self, operation_id: str, show: Callable[[Json], None]) -> Json:
        """Poll an operation until it ends, showing each state; returns the last."""
        while True:
            operation = _body(self._http.get(f"/v1/operations/{operation_id}"))
            show(operation)
            if operation["state"] in ("SUCCEEDED", "FAILED", "CANCELLED"):
                return operation
            time.sleep(0.5)

    def scene(self, scene_id: str) -> Json:
        return _body(self._http.get(f"/v1/scenes/{scene_id}"))

    def query(self, scene_id: str, text: str) -> Json:
        answers = _body(self._http.get("/query", params={"text": text, "scene": scene_id}))["answers"]
        (answer,) = answers
        return dict(answer)

    def picture(self, scene_id: str, kind: str, *, view: str, text: str = "") -> bytes:
        params = {"view": view, **({"text": text} if text else {})}
        response = self._http.get(f"/v1/scenes/{scene_id}/{kind}.png", params=params)
        _check(response)
        return response.content

    def download(self, path: str, params: dict[str, str], target: Path) -> None:
        with self._http.stream("GET", path, params=params) as response:
            if not response.is_success:
                response.read()
            _check(response)
            with target.open("wb") as sink:
                for chunk in response.iter_bytes():
                    sink.write(chunk)


def _parts(capture: Path) -> Iterator[tuple[str, str, Path]]:
    if capture.is_file():
        yield "capture", capture.name, capture
        return
    images = sorted(path for path in capture.rglob("*") if path.suffix.lower() in _IMAGE_SUFFIXES)
    if not images:
        raise SystemExit(f"{capture} holds no images ({', '.join(sorted(_IMAGE_SUFFIXES))})")
    for path in images:
        yield "images", path.relative_to(capture).as_posix(), path


def _check(response: httpx.Response) -> None:
    if not response.is_success:
        raise Refused(f"{response.status_code} {response.url.path}: {json.dumps(response.json(), indent=2)}")


def _body(response: httpx.Response) -> Json:
    _check(response)
    return dict(response.json())
