"""The server's own namer: nothing is sent before the project agreed, and what it says are suggestions."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from pydantic import ValidationError
from typer.testing import CliRunner

from benchmarks.naming.replay import ReplayNamer, named, replayed
from fastsplat.cli.main import app
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import NamerSettings, Settings, load_settings
from fastsplat_contract.errors import (
    InvalidInputError,
    ModelUnavailableError,
    NamerError,
    NotReadyError,
    PermissionDeniedError,
)
from fastsplat_contract.thing_sheets import ThingSheet
from tests.api.clients import client_of
from tests.api.nameless import Nameless, nameless_sample, seen_with_errors
from tests.cli.conftest import configured


class Room(NamedTuple):
    """A server that has a namer, which says what `says` says, and a scene without names."""

    nameless: Nameless
    namer: ReplayNamer
    host: str


def _nothing(_: ThingSheet) -> Any:
    return {"names": []}


@pytest.fixture
def room(models_dir: Path, tmp_path: Path) -> Iterator[Room]:
    with replayed([], _nothing) as namer:
        settings = NamerSettings(url=namer.url, model="eyes:7b", key="secret")
        with nameless_sample(models_dir, tmp_path, settings) as nameless:
            with client_of(nameless.faces) as client:
                namer.sheets.update({sheet.picture: sheet for sheet in client.thing_sheets(nameless.scene_id)})
            yield Room(nameless, namer, settings.host)


def test_nothing_is_sent_before_the_project_agreed_to_this_host_nor_after_it_took_that_back(room: Room) -> None:
    with client_of(room.nameless.faces) as client:
        status = client.server_status().namer
        assert status is not None and (status.host, status.model, status.agreed) == (room.host, "eyes:7b", False)
        with pytest.raises(PermissionDeniedError, match=room.host):
            client.ask_namer(room.nameless.scene_id)
        with pytest.raises(InvalidInputError) as raised:
            client.agree_to_namer("elsewhere.example")
        assert raised.value.field == "host"
        assert not room.namer.got
        assert client.agree_to_namer(room.host).agreed
        again = client.server_status().namer
        assert again is not None and again.agreed
        client.ask_namer(room.nameless.scene_id)
        sent = len(room.namer.got)
        assert sent == len(room.namer.sheets)
        assert not client.agree_to_namer("").agreed
        with pytest.raises(PermissionDeniedError):
            client.ask_namer(room.nameless.scene_id)
        assert len(room.namer.got) == sent


def test_an_agreement_holds_for_its_host_alone_and_for_its_project_alone(tmp_path: Path) -> None:
    def agreed(service: SceneService) -> bool:
        status = service.status("editor", "").namer
        assert status is not None and service.status("reader", "").namer is None
        return status.agreed

    settings = Settings(data_dir=tmp_path, namer=NamerSettings(url="http://localhost:9/v1", model="eyes"))
    with open_service(settings) as service:
        scene_id = service.open_sample().id
        service.admin.projects.create("other")
        assert service.namer.agree("localhost:9").agreed and agreed(service)
        assert not agreed(service.in_project("other"))
    elsewhere = NamerSettings(url="http://localhost:10/v1", model="eyes")
    with open_service(settings.model_copy(update={"namer": elsewhere})) as service:
        assert not agreed(service)
        with pytest.raises(PermissionDeniedError):
            service.namer.ask(scene_id)
    with open_service(settings) as service:
        assert agreed(service)
    with open_service(Settings(data_dir=tmp_path)) as service:
        assert service.status("operator", "").namer is None
        with pytest.raises(ModelUnavailableError):
            service.namer.ask(scene_id)


def test_what_it_sees_is_suggested_as_one_version_and_nothing_is_stated(room: Room) -> None:
    seen = seen_with_errors(room.nameless.truth, 1)
    room.namer.says = lambda sheet: named(sheet, seen, 0.9)
    with client_of(room.nameless.faces) as client:
        client.agree_to_namer(room.host)
        told = client.ask_namer(room.nameless.scene_id)
        assert told.suggested == len(seen) and told.refused == 0 and told.problem == ""
        scene = client.scene(room.nameless.scene_id)
        assert told.version == scene.version
        things = {each.id: each for each in client.things(room.nameless.scene_id)}
        assert not any(each.name for each in things.values())
        reached = [things[thing].suggestions[0].name == name for thing, name in room.nameless.truth.items()]
        assert np.mean(reached) >= 0.85
        sources = {one.source for each in things.values() for told in each.suggestions for one in told.said_by}
        assert sources == {"detector", "eyes:7b"}
    sent = json.dumps([body for _, _, body in room.namer.got])
    assert {headers["authorization"] for _, headers, _ in room.namer.got} == {"Bearer secret"}
    for private in (room.nameless.scene_id, scene.name, *(camera.name for camera in scene.cameras)):
        assert private and private not in sent


def test_a_poster_names_nothing_and_a_namer_that_fails_is_told(room: Room) -> None:
    room.namer.says = lambda sheet: named(sheet, {each.thing: "cat" for each in sheet.things}, 1.0)
    with client_of(room.nameless.faces) as client:
        client.agree_to_namer(room.host)
        before = client.scene(room.nameless.scene_id).version
        told = client.ask_namer(room.nameless.scene_id)
        assert (told.suggested, told.version) == (0, before) and told.refused == told.shown > 0
        for status in (401, 500):
            failing = (status, {}, b"")
            room.namer.says = lambda _, answer=failing: answer
            with pytest.raises(NamerError) as raised:
                client.ask_namer(room.nameless.scene_id)
            assert room.host in str(raised.value)
        assert client.scene(room.nameless.scene_id).version == before


def test_one_scene_at_a_time_is_asked_about(room: Room) -> None:
    asked, go_on = threading.Event(), threading.Event()

    def wait(_: ThingSheet) -> Any:
        asked.set()
        assert go_on.wait(60)
        return {"names": []}

    room.namer.says = wait
    with client_of(room.nameless.faces) as client, client_of(room.nameless.faces) as other:
        client.agree_to_namer(room.host)
        first = threading.Thread(target=client.ask_namer, args=(room.nameless.scene_id,))
        first.start()
        try:
            assert asked.wait(60)
            with pytest.raises(NotReadyError, match="another scene"):
                other.ask_namer(room.nameless.scene_id)
        finally:
            go_on.set()
            first.join()
        assert other.ask_namer(room.nameless.scene_id).suggested == 0


def test_the_command_agrees_to_the_host_that_is_named_and_asks(room: Room) -> None:
    room.namer.says = lambda sheet: named(sheet, room.nameless.truth, 0.9)
    server = ["--server", str(room.nameless.faces.rest.base_url)]
    command = ["things", "ask-namer", room.nameless.scene_id]
    refused = CliRunner().invoke(app, [*command, *server])
    assert refused.exit_code != 0 and not room.namer.got
    done = CliRunner().invoke(app, [*command, "--agree", room.host, *server])
    assert done.exit_code == 0, (done.output, done.exception)
    assert f"{len(room.nameless.truth)} names suggested" in done.stdout


@pytest.mark.parametrize("url", ["localhost:11434", "http://", "http://user:key@host/v1", "file:///x", "http://h/?k=1"])
def test_an_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(ValidationError):
        NamerSettings(url=url, model="eyes")


def test_the_settings_name_the_model_and_read_the_key_from_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ValidationError, match="needs a model"):
        NamerSettings(url="http://localhost:11434/v1")
    (tmp_path / "key").write_text("secret\n")
    monkeypatch.setenv("FASTSPLAT_NAMER__URL", "http://localhost:11434/v1")
    monkeypatch.setenv("FASTSPLAT_NAMER__MODEL", "eyes")
    monkeypatch.setenv("FASTSPLAT_NAMER__KEY_FILE", str(tmp_path / "key"))
    with configured(tmp_path):
        namer = load_settings().namer
    assert (namer.host, namer.key) == ("localhost:11434", "secret") and "secret" not in repr(namer)
