"""A stand-in for a model behind the OpenAI chat format: it knows sheets by their pictures, and says of each object what
it was told beforehand."""

from __future__ import annotations

import base64
import json
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from fastsplat_contract.messages.contact_sheets import ContactSheet

Says = Callable[[ContactSheet], Any]
"""What is said of a sheet: JSON, or the bytes of a whole response with its status."""


class ReplayCaptioner(ThreadingHTTPServer):
    """Answers `chat/completions` with what `says` says of the sheet whose picture came, and remembers what it got."""

    def __init__(self, sheets: Sequence[ContactSheet], says: Says) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.sheets = {sheet.picture: sheet for sheet in sheets}
        self.says = says
        self.got: list[tuple[str, Mapping[str, str], Any]] = []
        self.url = f"http://127.0.0.1:{self.server_address[1]}/v1"

    def handle_error(self, request: Any, client_address: Any) -> None:
        pass  # a client that has given up


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: ReplayCaptioner

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["content-length"])))
        self.server.got.append((self.path, {name.lower(): text for name, text in self.headers.items()}, body))
        text, picture = body["messages"][1]["content"]
        head, _, data = picture["image_url"]["url"].partition(",")
        assert head == "data:image/jpeg;base64" and text["type"] == "text"
        said = self.server.says(self.server.sheets[base64.b64decode(data)])
        if isinstance(said, tuple):
            status, headers, content = said
        else:
            status, headers = 200, {}
            content = json.dumps(
                {"choices": [{"message": {"role": "assistant", "content": json.dumps(said)}}]}
            ).encode()
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("content-length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: Any) -> None:
        pass


@contextmanager
def replayed(sheets: Sequence[ContactSheet], says: Says) -> Iterator[ReplayCaptioner]:
    """Serve it on this machine until the block ends."""
    server = ReplayCaptioner(sheets, says)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def named(sheet: ContactSheet, names: Mapping[int, str], probability: float = 0.9) -> dict[str, Any]:
    """An answer as it is asked for, with the names of objects by their ids."""
    entries = [
        {"number": obj.number, "name": names[obj.object_id], "probability": probability, "aliases": []}
        for obj in sheet.objects
        if obj.object_id in names
    ]
    return {"names": entries}
