"""Client of all calls, over REST; subscriptions over gRPC."""

from __future__ import annotations

import io
import time
import uuid
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeVar
from urllib.parse import urlsplit

import httpx
import numpy as np
from numpy.typing import NDArray

from fastsplat_client.captures import CaptureFiles
from fastsplat_client.errors import UnreachableError, problem_of, read
from fastsplat_client.job_calls import JobCalls
from fastsplat_client.keys import ClientKeys
from fastsplat_client.object_calls import ClientKnownNames, ObjectCalls
from fastsplat_client.photo_calls import PhotoCalls
from fastsplat_client.releases import fitting
from fastsplat_client.resumable import PIECE_BYTES, dropped_if_refused, send_resumable
from fastsplat_client.stream import Grpc, StreamCalls, grpc_address
from fastsplat_client.table_calls import in_path, scene_path
from fastsplat_client.transport import Retry, Transport, events_of
from fastsplat_contract import calls
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.errors import DeadlineExceededError, FastSplatError, Kind
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.jobs.operations import Operation, OperationState, SceneOptions
from fastsplat_contract.masks import decode_mask3d
from fastsplat_contract.messages import requests
from fastsplat_contract.messages.exports import ExportFormat
from fastsplat_contract.messages.queries import Answer, Output, QueryOut, QueryRequest
from fastsplat_contract.messages.scenes import DictionaryEntry, Scene, SceneSummary
from fastsplat_contract.photos.photo_verdicts import PhotoVerdict
from fastsplat_contract.photos.pictures import PictureKind, PictureRequest, Tint
from fastsplat_contract.server.server_info import ServerInfo
from fastsplat_contract.server.server_status import ServerStatus

T = TypeVar("T")

_USUAL = Retry()
_LONG_POLL_S = 20.0


class Client(ObjectCalls, JobCalls, PhotoCalls, StreamCalls, AbstractContextManager["Client"]):
    """Thread-safe client of one server; a context manager.

    Idempotent calls are retried; creating calls carry a request id that makes them idempotent. All calls raise the
    server's `FastSplatError`, `UnreachableError` or `DeadlineExceededError`.

    Args:
        url: URL of the REST interface.
        key: access key; "" if the server needs none.
        grpc_target: "host:port" of gRPC; by default as the server reports. The key goes to these two addresses only.
        project: the project, for operators; "": the key's own, the only one that other keys may name.
        ca: PEM certificates to trust instead of the system's, for both interfaces.
        timeout_s: default timeout of a call, retries included.
        retry: retry policy.
        piece_bytes: piece size of large uploads, the most that a broken connection costs.
        transport: replaces the network for REST, e.g. for a server in the same process.

    Examples:
        >>> from fastsplat.cli.connection import Address, open_client  # a client of a data folder in this process
        >>> with open_client(Address(data="sample")) as client:
        ...     (scene,) = client.scenes()
        ...     scene.name, scene.scale, [label.label for label in client.labels(scene.id)][:3]
        ('sample', 'METRIC', ['apple', 'banana', 'book'])
    """

    def __init__(
        self,
        url: str = "http://127.0.0.1:8000",
        *,
        key: str = "",
        grpc_target: str = "",
        project: str = "",
        ca: Path | None = None,
        timeout_s: float = 60.0,
        retry: Retry = _USUAL,
        piece_bytes: int = PIECE_BYTES,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        headers = {"Authorization": f"Bearer {key}" if key else "", "X-Fastsplat-Project": project}
        self._headers = {name: value for name, value in headers.items() if value}
        super().__init__(Transport(url, self._headers, ca, timeout_s, retry, transport))
        self.known_names = ClientKnownNames(self._transport)
        """Names given in the project's scenes, suggested in others."""
        self.keys = ClientKeys(self._transport)
        """Access keys of the project, for admins and operators."""
        self._url = urlsplit(url)
        self._grpc_target = grpc_target
        self._ca = ca
        self._timeout_s = timeout_s
        self._retry = retry
        self._piece_bytes = piece_bytes

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connections."""
        self._transport.close()

    def server(self) -> ServerInfo:
        """Gets the server's release and gRPC address; warns by `ReleaseWarning` if the release is incompatible."""
        return fitting(read(ServerInfo, self._transport.call("GET", "/v1/server")))

    def server_status(self) -> ServerStatus:
        """Gets the server's capabilities and the project's quota, as visible to the caller."""
        return fitting(self.call(calls.GET_SERVER_STATUS, None))

    def create_scene(
        self,
        capture: Path,
        *,
        photos: Path | None = None,
        name: str = "",
        options: SceneOptions | None = None,
        request_id: str = "",
        timeout_s: float = 3600.0,
    ) -> Operation:
        """Uploads a folder, an archive, a video or a splat, and durably queues its training.

        A folder may hold photos, transforms.json or a COLMAP model, masks, label maps with labels.json, points, a
        splat. A single file is uploaded resumably. A splat may be sent with the folder of its `photos`.
        """
        options = options or SceneOptions()
        fields = [("name", name), ("request_id", request_id or uuid.uuid4().hex)]
        for field, default in vars(SceneOptions()).items():
            if (value := getattr(options, field)) != default:
                fields += [(field, str(item)) for item in (value if isinstance(value, tuple) else (value,))]
        sent = ""
        if capture.is_file() and photos is None:
            sent = send_resumable(self._transport, capture, self._retry, timeout_s, self._piece_bytes)
            fields.append(("uploads", sent))
        with dropped_if_refused(self._transport, sent), CaptureFiles(capture, photos) as files:
            response = self._transport.call(
                "POST", "/v1/scenes", content=lambda: {"files": files.form(fields)}, timeout_s=timeout_s
            )
        return read(Operation, response)

    def operations(self, state: OperationState | None = None) -> Iterator[Operation]:
        """Lists jobs, newest first."""
        pages = self._pages(calls.LIST_OPERATIONS, requests.ListOperationsRequest(state=state))
        return (operation for page in pages for operation in page.operations)

    def watch(self, operation_id: str) -> Iterator[Operation]:
        """Yields the job now and on every change until it is done; resumes broken connections."""
        path, last, failures = f"/v1/operations/{in_path(operation_id)}/events", "", 0
        while True:
            try:
                headers = {"Last-Event-ID": last} if last else {}
                with self._transport.streamed(path, headers=headers) as response:
                    for event in events_of(response.iter_lines()):
                        if event.kind == "error":
                            raise problem_of(event.data)
                        last, failures = event.id, 0
                        operation = read(Operation, event.data)
                        yield operation
                        if operation.done:
                            return
                    if response.status_code == 204:
                        return
            except FastSplatError as error:
                failures += 1
                if error.kind not in (Kind.UNAVAILABLE, Kind.DEADLINE_EXCEEDED) or failures >= self._retry.tries:
                    raise
                time.sleep(self._retry.pause(failures - 1))

    def wait(self, operation_id: str, *, timeout_s: float = float("inf")) -> Operation:
        """Waits until a job is done, successfully or not; raises `DeadlineExceededError` after `timeout_s`."""
        deadline = time.monotonic() + timeout_s
        while True:
            left = max(0.0, deadline - time.monotonic())
            request = requests.WaitOperationRequest(operation_id, min(left, _LONG_POLL_S))
            operation = self.call(calls.WAIT_OPERATION, request, timeout_s=_LONG_POLL_S + 60.0)
            if operation.done:
                return operation
            if left <= 0:
                raise DeadlineExceededError(f"operation {operation_id} is {operation.state} after {timeout_s:g} s")

    def scene(self, scene_id: str) -> Scene:
        """Gets a scene with its dictionary, cameras and quality."""
        return self.call(calls.GET_SCENE, requests.GetSceneRequest(scene_id))

    def scenes(self) -> Iterator[SceneSummary]:
        """Lists scenes, newest first, without dictionary, cameras and quality."""
        pages = self._pages(calls.LIST_SCENES, requests.ListScenesRequest())
        return (scene for page in pages for scene in page.scenes)

    def open_sample(self) -> Scene:
        """Gets the project's copy of the server's sample scene, and creates it if necessary."""
        return self.call(calls.OPEN_SAMPLE, requests.OpenSampleRequest())

    def rename_scene(self, scene_id: str, name: str, *, expected_name: str | None = None) -> Scene:
        """Renames a scene; with `expected_name`, only if that or `name` is its name."""
        return self.call(calls.UPDATE_SCENE, requests.UpdateSceneRequest(scene_id, name, expected_name))

    def delete_scene(self, scene_id: str) -> None:
        """Deletes a scene and all its files."""
        self.call(calls.DELETE_SCENE, requests.DeleteSceneRequest(scene_id))

    def labels(self, scene_id: str) -> Iterator[DictionaryEntry]:
        """Lists a scene's dictionary by label id."""
        pages = self._pages(calls.LIST_LABELS, requests.ListLabelsRequest(scene_id))
        return (label for page in pages for label in page.labels)

    def photo_verdicts(self, scene_id: str) -> Iterator[PhotoVerdict]:
        """Lists each photo's outcome by name; empty until the capture stage is done."""
        pages = self._pages(calls.LIST_PHOTO_VERDICTS, requests.ListPhotoVerdictsRequest(scene_id))
        return (photo for page in pages for photo in page.photos)

    def query(
        self,
        scene_id: str,
        texts: str | Sequence[str],
        *,
        cameras: Sequence[PosedCamera] = (),
        views: Sequence[str] = (),
        outputs: Iterable[Output] = (),
        timeout_s: float | None = None,
        **choices: Any,
    ) -> tuple[Answer, ...]:
        """Asks a scene, or with "" all scenes; returns answers per text and scene.

        Args:
            cameras, views: free viewpoints, and names of the scene's cameras, for 2D masks.
            outputs: any of "mask2d", "mask3d" and "objects".
            timeout_s: cancels the server's work, too.
            choices: other fields of `QueryRequest`, e.g. version, max_matches, asker_view.
        """
        questions = (texts,) if isinstance(texts, str) else tuple(texts)
        request = QueryRequest(scene_id, questions, tuple(cameras), tuple(views), frozenset(outputs), **choices)
        return self.ask(request, timeout_s=timeout_s)

    def ask(
        self, request: QueryRequest, *, timeout_s: float | None = None, protocol: Literal["REST", "gRPC"] = "REST"
    ) -> tuple[Answer, ...]:
        """Asks a `QueryRequest` over either protocol; gRPC does not retry."""
        return self.ask_everywhere(request, timeout_s=timeout_s, protocol=protocol).answers

    def ask_everywhere(
        self, request: QueryRequest, *, timeout_s: float | None = None, protocol: Literal["REST", "gRPC"] = "REST"
    ) -> QueryOut:
        """Asks as `ask`, and also returns scenes that were skipped as damaged or too many."""
        if protocol == "gRPC":
            return self._grpc().ask(request, self._timeout_s if timeout_s is None else timeout_s)
        body = {name: value for name, value in to_plain(request).items() if name != "scene_id"}
        if request.scene_id:
            path = f"{scene_path(request.scene_id)}:query"
            response = self._transport.call("POST", path, json=body, timeout_s=timeout_s)
        else:
            for field in ("cameras", "views", "mask2d_encoding", "asker"):
                body.pop(field)
            params = {"text": body.pop("texts")} | {name: value for name, value in body.items() if value is not None}
            response = self._transport.call("GET", "/query", params=params, timeout_s=timeout_s)
        return read(QueryOut, response)

    def mask3d(self, scene_id: str, text: str, *, version: str = "") -> NDArray[np.bool_]:
        """Segments the Gaussians that answer a text: bool [G], by Gaussian id of the version."""
        (answer,) = self.query(scene_id, text, outputs=["mask3d"], version=version, max_matches=1)
        return decode_mask3d(answer.mask3d or b"", "bits", answer.gaussians)

    def picture(
        self,
        scene_id: str,
        kind: PictureKind,
        viewpoint: str | PosedCamera,
        *,
        text: str = "",
        version: str = "",
        depth_scale: float = 0.0,
        image_format: Literal["png", "jpeg"] = "png",
        tints: Sequence[Tint] = (),
        dimming: float = 0.0,
    ) -> bytes:
        """Renders a PNG or JPEG from a camera's name or free viewpoint; see `RenderIn`."""
        more: dict[str, Any] = {"format": image_format, "tints": tuple(tints), "dimming": dimming}
        request = PictureRequest(scene_id, kind, text or None, version=version, depth_scale=depth_scale, **more)
        return self._render(viewpoint, request)

    def label_map(self, scene_id: str, viewpoint: str | PosedCamera, *, version: str = "") -> NDArray[np.uint16]:
        """Renders label ids: uint16 [H, W], 0 where undetected or coverage is too low."""
        return np.asarray(self._array(scene_id, "label_map", viewpoint, version), dtype=np.uint16)

    def object_map(self, scene_id: str, viewpoint: str | PosedCamera, *, version: str = "") -> NDArray[np.uint16]:
        """Renders object ids: uint16 [H, W], 0 for none or too low coverage."""
        return np.asarray(self._array(scene_id, "object_map", viewpoint, version), dtype=np.uint16)

    def depth(self, scene_id: str, viewpoint: str | PosedCamera, *, version: str = "") -> NDArray[np.float32]:
        """Renders depth: float32 [H, W], camera z in scene units, 0 where empty."""
        return np.asarray(self._array(scene_id, "depth", viewpoint, version), dtype=np.float32)

    def normals(self, scene_id: str, viewpoint: str | PosedCamera, *, version: str = "") -> NDArray[np.float32]:
        """Renders unit normals: float32 [H, W, 3], world frame, towards the camera, 0 where empty."""
        return np.asarray(self._array(scene_id, "normals", viewpoint, version), dtype=np.float32)

    def confidence(self, scene_id: str, viewpoint: str | PosedCamera, *, version: str = "") -> NDArray[np.float32]:
        """Renders confidence of depth and normals: float32 [H, W] in 0..1, 0 where empty."""
        return np.asarray(self._array(scene_id, "confidence", viewpoint, version), dtype=np.float32)

    def download_scene(self, scene_id: str, target: Path, *, version: str = "") -> str:
        """Downloads the scene as a 3DGS PLY file, resuming broken connections; returns its ETag."""
        path, params = f"{scene_path(scene_id)}/scene.ply", {"version": version} if version else {}
        tag, failures = "", 0
        with target.open("wb") as file:
            while True:
                # If-Range restarts the download if another version has become current.
                headers = {"Range": f"bytes={file.tell()}-", "If-Range": tag} if tag and file.tell() else {}
                try:
                    with self._transport.streamed(path, params=params, headers=headers) as response:
                        if response.status_code != 206:
                            file.seek(0)
                            file.truncate()
                        tag = response.headers["etag"]
                        for piece in response.iter_bytes():
                            file.write(piece)
                            failures = 0
                        return tag
                except UnreachableError:
                    failures += 1
                    if failures >= self._retry.tries:
                        raise
                    time.sleep(self._retry.pause(failures - 1))

    def export(
        self,
        scene_id: str,
        file_format: ExportFormat = "ply",
        *,
        version: str = "",
        objects: Sequence[int] = (),
        cell: float = 0.0,
    ) -> bytes:
        """Exports a scene, or only some objects; formats and cell as in `ExportRequest`."""
        params = {"version": version, "object_ids": list(objects), "cell": cell}
        return self._transport.call("GET", f"{scene_path(scene_id)}/scene.{file_format}", params=params).content

    def _render(self, viewpoint: str | PosedCamera, request: PictureRequest) -> bytes:
        where = {"view": viewpoint} if isinstance(viewpoint, str) else {"camera": viewpoint}
        return self.call(calls.RENDER_VIEW, replace(request, **where))

    def _array(self, scene_id: str, kind: PictureKind, viewpoint: str | PosedCamera, version: str) -> NDArray[Any]:
        content = self._render(viewpoint, PictureRequest(scene_id, kind, version=version, format="npy"))
        array: NDArray[Any] = np.load(io.BytesIO(content), allow_pickle=False)
        return array

    def _grpc(self) -> Grpc:
        self._grpc_target = self._grpc_target or grpc_address(self.server(), self._url.hostname or "")
        return Grpc(self._grpc_target, self._headers, self._url.scheme == "https", self._ca)
