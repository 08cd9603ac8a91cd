"""Connects a command to a service, over HTTP or in this process."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fastsplat.cli.lazy_settings import load_settings
from fastsplat_contract.errors import InvalidInputError, NotFoundError

if TYPE_CHECKING:
    import httpx

    from fastsplat.service.settings import Settings
    from fastsplat.service.store.store import Store
    from fastsplat_client import Client
    from fastsplat_contract.server.keys import NewKey

SAMPLE = "sample"
"""What stands for the sample scene in the place of a folder, where there is no folder of that name."""
SERVER_VARIABLE, KEY_VARIABLE = "FASTSPLAT_SERVER", "FASTSPLAT_KEY"

_CALL_S = 600.0
"""Seconds that a call may take; a server ends its own calls after so long."""


@dataclass(frozen=True)
class Address:
    """Where a service is.

    Attributes:
        server: URL of a running one; "": none was named on the command line.
        key_file: has the key for `server`; None: the environment has it.
        ca: PEM certificates to trust in place of the system's.
        data: data folder of one that runs in this process, or `SAMPLE`; "": that of the settings.
        project: which project to ask about; "": the key's own, or the default one.
    """

    server: str = ""
    key_file: Path | None = None
    ca: Path | None = None
    data: str = ""
    project: str = ""

    @property
    def url(self) -> str:
        """Of the running service to ask; "" for the one in this process."""
        return self.server or ("" if self.data else os.environ.get(SERVER_VARIABLE, ""))

    def of_scene(self, text: str) -> Address:
        """The target that `text` names, a data folder or the sample, unless one is given."""
        named = self.server or self.data or not (_is_data_folder(text) or is_sample(text))
        return self if named else replace(self, data=text)


@contextmanager
def open_client(address: Address) -> Iterator[Client]:
    """Opens a client of a server or, as its operator, of a folder; `InvalidInputError`, `NotFoundError`."""
    from fastsplat_client import Client  # loads gRPC

    if address.server and address.data:
        raise InvalidInputError("both a server and a data folder", field="--data", hint="Name one of them.")
    if address.url:
        key = os.environ.get(KEY_VARIABLE, "") if address.key_file is None else _text_of(address.key_file, "--key-file")
        if address.ca is not None:
            _text_of(address.ca, "--ca")
        with Client(address.url, key=key, ca=address.ca, project=address.project, timeout_s=_CALL_S) as client:
            yield client
        return
    with (
        _settings_of(address.data) as settings,
        _in_process(settings) as carrier,
        Client(project=address.project, timeout_s=_CALL_S, transport=carrier) as client,
    ):
        yield client


def is_sample(text: str) -> bool:
    """True for the sample scene."""
    return text == SAMPLE and not Path(text).exists()


def link_to_share(page: str, new_key: NewKey) -> str:
    """The address of the page that shows the one scene of a key, see `share_link`."""
    from fastsplat_client import share_link

    return share_link(page, new_key)


@contextmanager
def local_store(*, adopting: bool = False) -> Iterator[Store]:
    """Opens the store of the settings' data folder, to mend or save it."""
    from fastsplat.service.store.store import open_store  # loads the database's library

    settings = load_settings()
    store = open_store(settings.data_dir, settings.database_url, settings.artefacts, adopting=adopting)
    try:
        yield store
    finally:
        store.close()


@contextmanager
def _settings_of(data: str) -> Iterator[Settings]:
    if not data:
        yield load_settings()
        return
    from fastsplat.service.library.local_scene import folder_settings
    from fastsplat.service.library.sample import sample_folder

    if is_sample(data):
        with sample_folder() as folder:
            yield folder_settings(folder)
    elif Path(data).is_dir():
        yield folder_settings(Path(data))
    else:
        raise NotFoundError(f"there is no data folder {data}", field="--data", hint="Make it, or name another one.")


@contextmanager
def _in_process(settings: Settings) -> Iterator[httpx.BaseTransport]:
    """Carries requests to a service over a data folder, in this process, without keys."""
    from fastsplat.api.access.gate import build_gate
    from fastsplat.api.rest.app import create_app
    from fastsplat.api.rest.in_process import InProcess, running_loop
    from fastsplat.api.threads import Threads
    from fastsplat.service.application.service import open_service

    # Here each question is the first, which reads the scene and the models.
    limits = settings.limits.model_copy(update={"answer_s": _CALL_S})
    access = {"auth": "off", "host": "127.0.0.1", "cors_origins": (), "root_path": ""}
    local_settings = settings.model_copy(update={**access, "limits": limits})
    with open_service(settings) as service, running_loop() as loop:
        threads = Threads(limits, uploads=settings.uploads)
        app = create_app(service, local_settings, threads, build_gate(local_settings, service.admin))
        transport = InProcess(app, loop, ("127.0.0.1", 0))
        try:
            yield transport
        finally:
            transport.stop()
            threads.close()


def _is_data_folder(text: str) -> bool:
    if not text or not Path(text).is_dir():
        return False
    from fastsplat.service.store.rows.database import SQLITE_NAME  # loads the database's library

    return (Path(text) / SQLITE_NAME).is_file()


def _text_of(file: Path, option: str) -> str:
    try:
        return file.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError(f"{file} cannot be read: {error}", field=option) from error
