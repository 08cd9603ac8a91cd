"""A TCP line to a server on this machine that can be cut, taken down and silenced."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress


class Line:
    """Carries bytes to a port until it is told otherwise; each connection ends after `most_bytes` of its client."""

    def __init__(self, port: int, most_bytes: int = 1 << 60) -> None:
        self._far_port = port
        self._most_bytes = most_bytes
        self._pairs: list[_Pair] = []
        self._listen(0)
        self.port = int(self._listener.getsockname()[1])

    @property
    def connections(self) -> int:
        """How many there have been."""
        return len(self._pairs)

    def cut(self) -> None:
        """End every connection, as when the server is killed; new ones are carried."""
        for pair in self._pairs:
            pair.end()

    def take_down(self) -> None:
        """The same, and refuse new connections."""
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._accepting.join()
        self.cut()

    def bring_up(self) -> None:
        """Take connections again, on the same port."""
        self._listen(self.port)

    def silence(self) -> None:
        """Lose what the present connections send, without ending them; new ones are carried."""
        for pair in self._pairs:
            pair.silent = True

    def _listen(self, port: int) -> None:
        self._listener = socket.create_server(("127.0.0.1", port))
        self._accepting = threading.Thread(target=self._accept, args=(self._listener,), daemon=True)
        self._accepting.start()

    def _accept(self, listener: socket.socket) -> None:
        with suppress(OSError):
            while True:
                near, _ = listener.accept()
                far = socket.create_connection(("127.0.0.1", self._far_port))
                self._pairs.append(_Pair(near, far, self._most_bytes))


class _Pair:
    """The two ends of one connection."""

    def __init__(self, near: socket.socket, far: socket.socket, most_bytes: int) -> None:
        self._ends = (near, far)
        self.silent = False
        for way in ((near, far, most_bytes), (far, near, 1 << 60)):
            threading.Thread(target=self._pump, args=way, daemon=True).start()

    def end(self) -> None:
        for end in self._ends:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _pump(self, source: socket.socket, sink: socket.socket, left: int) -> None:
        with suppress(OSError), source:
            while left and (data := source.recv(min(1 << 16, left))):
                left -= len(data)
                if not self.silent:
                    sink.sendall(data)
        self.end()
