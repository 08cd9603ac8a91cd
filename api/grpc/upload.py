"""`CreateScene`: the stream of header, files and chunks into an upload session while it arrives."""

from __future__ import annotations

from collections.abc import Iterator

from fastsplat.api.uploads import scene_options
from fastsplat.service.application.service import SceneService
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.operations import Operation
from fastsplat_contract.v1 import fastsplat_pb2 as pb


def receive_scene(service: SceneService, messages: Iterator[pb.CreateSceneRequest]) -> Operation:
    """Take the files and queue their job; anything refused leaves nothing behind.

    Raises:
        FastSplatError: what the order of the messages, the files or the service's limits have against it.
    """
    first = next(messages, None)
    if first is None or first.WhichOneof("part") != "header":
        raise InvalidInputError(
            "the first message is not a header", field="header", hint="Send a CreateSceneHeader, then the files."
        )
    header = first.header
    options = scene_options(
        header.labels,
        header.time_budget_s if header.HasField("time_budget_s") else None,
        header.max_gaussians if header.HasField("max_gaussians") else None,
        header.preset,
        header.priority,
        header.up,
    )
    with service.new_upload() as upload:
        files = _Files(messages)
        while (file := files.next()) is not None:
            size = upload.write(file.name, files.chunks())
            if file.HasField("size_bytes") and size != file.size_bytes:
                raise InvalidInputError(
                    f"{size} bytes came, {file.size_bytes} were announced", field=file.name, hint="Send it again."
                )
        return service.create_scene(upload, header.name, header.request_id, options)


class _Files:
    """Groups the messages behind the header by file."""

    def __init__(self, messages: Iterator[pb.CreateSceneRequest]) -> None:
        self._messages = messages
        self._ahead = next(messages, None)

    def next(self) -> pb.FileHeader | None:
        """The next file, or None at the end of the stream."""
        if self._ahead is None:
            return None
        if self._ahead.WhichOneof("part") != "file":
            raise InvalidInputError(
                f"a {self._ahead.WhichOneof('part') or 'message without content'} where a file should begin",
                field="file",
                hint="Send a FileHeader before its chunks, and the header only once.",
            )
        return self._ahead.file

    def chunks(self) -> Iterator[bytes]:
        """The bytes of the file that has just begun."""
        for message in self._messages:
            if message.WhichOneof("part") != "chunk":
                self._ahead = message
                return
            yield message.chunk
        self._ahead = None
