"""`CreateScene`: writes the stream of header, files and chunks to an upload session."""

from __future__ import annotations

from collections.abc import Sequence

from fastsplat.api.uploads import OPTIONS, scene_options
from fastsplat.service.application.service import SceneService
from fastsplat.service.application.uploading.uploads import UploadFile
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.jobs.operations import Operation, SceneOptions
from fastsplat_contract.v1 import fastsplat_pb2 as pb

MAX_MESSAGE_BYTES = 4 * 2**20
"""gRPC's default limit, which all clients have; larger content is streamed."""


class StreamSink:
    """The `api.receiving.Sink` of `CreateScene`; refused uploads leave nothing behind."""

    slow_finish = True  # validation

    def __init__(self, service: SceneService) -> None:
        self._service = service
        self._session = service.new_upload()
        self._header: pb.CreateSceneHeader | None = None
        self._options = SceneOptions()
        self._announced: pb.FileHeader | None = None
        self._file: UploadFile | None = None

    def write(self, items: Sequence[pb.CreateSceneRequest]) -> None:
        for message in items:
            part = message.WhichOneof("part")
            if self._header is None:
                self._take_header(message)
            elif part == "file":
                self._end_file()
                self._announced, self._file = message.file, self._session.begin(message.file.name)
            elif part == "chunk" and self._file is not None:
                self._file.write(message.chunk)
            else:
                raise InvalidInputError(
                    f"a {part or 'message without content'} where a file should begin",
                    field="file",
                    hint="Send a FileHeader before its chunks, and the header only once.",
                )

    def finish(self) -> Operation:
        if self._header is None:
            raise _no_header()
        self._end_file()
        return self._service.create_scene(self._session, self._header.name, self._header.request_id, self._options)

    def close(self) -> None:
        self._session.abort()

    def _take_header(self, message: pb.CreateSceneRequest) -> None:
        if message.WhichOneof("part") != "header":
            raise _no_header()
        header = message.header
        sent = {field.name: value for field, value in header.ListFields() if field.name in OPTIONS}
        self._options = scene_options(header.labels, sent)
        self._header = header

    def _end_file(self) -> None:
        if self._file is None or self._announced is None:
            return
        size = self._file.end()
        if self._announced.HasField("size_bytes") and size != self._announced.size_bytes:
            raise InvalidInputError(
                f"{size} bytes came, {self._announced.size_bytes} were announced",
                field=self._announced.name,
                hint="Send it again.",
            )
        self._file = None


def _no_header() -> InvalidInputError:
    return InvalidInputError(
        "the first message is not a header", field="header", hint="Send a CreateSceneHeader, then the files."
    )
