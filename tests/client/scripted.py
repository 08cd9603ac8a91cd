"""A server that answers with what a script says."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, TypeVar

Server = TypeVar("Server", bound=ThreadingHTTPServer)

OPERATION = {
    "id": "o",
    "scene_id": "s",
    "state": "QUEUED",
    "done": False,
    "created_at": "2026-01-01T00:00:00Z",
    "updated_at": "2026-01-01T00:00:00Z",
    "stages": [],
    "error": None,
}


def problem(status: int, reason: str, **more: Any) -> tuple[int, dict[str, str], bytes]:
    return status, {}, json.dumps({"reason": reason, "detail": "no", **more}).encode()


FINE = (200, {"Content-Type": "application/json"}, json.dumps(OPERATION).encode())  # an operation that was just queued


class Scripted(ThreadingHTTPServer):
    """Answers requests with what the script says, in order, and remembers them."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.script: list[Any] = []
        self.seen: list[tuple[str, dict[str, str], bytes]] = []
        self.url = f"http://127.0.0.1:{self.server_address[1]}"

    def answer_to(self, body: bytes) -> Any:
        """Status, headers and content, or the script's word for it."""
        return self.script.pop(0)

    def handle_error(self, request: Any, client_address: Any) -> None:
        pass  # a client that has given up


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        server: Any = self.server
        body = self.rfile.read(int(self.headers.get("content-length", 0)))
        server.seen.append(
            (f"{self.command} {self.path}", {name.lower(): value for name, value in self.headers.items()}, body)
        )
        step = server.answer_to(body)
        if step == "hang up":
            self.close_connection = True
            return
        if callable(step):
            step = step()
        status, headers, content = step
        cut = headers.pop("cut", None)
        self.send_response(status)
        for name, value in {"Content-Length": str(len(content)), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content[:cut])
        self.close_connection = cut is not None

    do_POST = do_DELETE = do_GET  # noqa: N815 - http.server's names

    def log_message(self, *arguments: Any) -> None:
        pass


def scripted() -> AbstractContextManager[Scripted]:
    return serving(Scripted())


@contextmanager
def serving(server: Server) -> Iterator[Server]:
    """Serve it on this machine until the block ends."""
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
