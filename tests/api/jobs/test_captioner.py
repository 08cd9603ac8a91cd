"""Captioners: the server's, ordered where the project agreed, and a person's; what they say are suggestions."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from pydantic import ValidationError

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import CaptionerSettings, Settings, load_settings
from fastsplat_client.captioner import Captioner, suggest_by
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError, PermissionDeniedError
from tests.api.clients import client_of
from tests.api.nameless import Nameless, nameless_sample
from tests.cli.conftest import configured
from tests.client.replay_captioner import ReplayCaptioner, named, replayed
from tests.commands import invoke


class Room(NamedTuple):
    """A server that has a captioner, and a scene without names."""

    nameless: Nameless
    captioner: ReplayCaptioner
    host: str


@pytest.fixture
def room(models_dir: Path, tmp_path: Path) -> Iterator[Room]:
    with replayed([], lambda _: {"names": []}) as captioner:
        settings = CaptionerSettings(url=captioner.url, model="eyes:7b", key="secret")
        with nameless_sample(models_dir, tmp_path, settings) as nameless:
            yield Room(nameless, captioner, settings.host)


def test_it_is_asked_only_while_the_project_agrees_to_this_host_once_for_each_request(room: Room) -> None:
    with client_of(room.nameless.faces) as client:
        status = client.server_status().captioner
        assert status is not None and (status.host, status.model, status.agreed) == (room.host, "eyes:7b", False)
        with pytest.raises(PermissionDeniedError, match=room.host):
            client.ask_captioner(room.nameless.scene_id)
        with pytest.raises(InvalidInputError) as raised:
            client.agree_to_captioner("elsewhere.example")
        assert raised.value.field == "host"
        assert client.agree_to_captioner(room.host).agreed
        again = client.server_status().captioner
        assert again is not None and again.agreed
        job = client.ask_captioner(room.nameless.scene_id, request_id="once")
        assert (job.kind, job.state, job.scene_id) == ("ask_captioner", "QUEUED", room.nameless.scene_id)
        assert client.ask_captioner(room.nameless.scene_id, request_id="once").id == job.id
        assert client.ask_captioner(room.nameless.scene_id).id != job.id
        assert not client.agree_to_captioner("").agreed
        with pytest.raises(PermissionDeniedError):
            client.ask_captioner(room.nameless.scene_id)
        assert not room.captioner.got, "a worker asks"


def test_an_agreement_holds_for_its_host_alone_and_for_its_project_alone(tmp_path: Path) -> None:
    def agreed(service: SceneService) -> bool:
        status = service.status("editor", "").captioner
        assert status is not None and service.status("reader", "").captioner is None
        return status.agreed

    settings = Settings(data_dir=tmp_path, captioner=CaptionerSettings(url="http://localhost:9/v1", model="eyes"))
    with open_service(settings) as service:
        scene_id = service.open_sample().id
        service.admin.projects.create("other")
        assert service.captioner.agree("localhost:9").agreed and agreed(service)
        assert not agreed(service.in_project("other"))
    elsewhere = CaptionerSettings(url="http://localhost:10/v1", model="eyes")
    with open_service(settings.model_copy(update={"captioner": elsewhere})) as service:
        assert not agreed(service)
        with pytest.raises(PermissionDeniedError):
            service.captioner.order(scene_id)
    with open_service(settings) as service:
        assert agreed(service)
    with open_service(Settings(data_dir=tmp_path)) as service:
        assert service.status("operator", "").captioner is None
        with pytest.raises(ModelUnavailableError):
            service.captioner.order(scene_id)


def test_the_command_agrees_to_the_host_that_is_named_and_asks(room: Room) -> None:
    server = ["--server", str(room.nameless.faces.rest.base_url)]
    command = ["objects", "ask-captioner", room.nameless.scene_id]
    refused = invoke(*command, *server)
    assert refused.exit_code != 0
    done = invoke(*command, "--agree", room.host, *server)
    assert done.exit_code == 0, (done.output, done.exception)
    assert f"of scene {room.nameless.scene_id} is QUEUED" in done.stdout


def test_the_settings_name_the_model_and_read_the_key_from_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ValidationError, match="needs a model"):
        CaptionerSettings(url="http://localhost:11434/v1")
    with pytest.raises(ValidationError):
        CaptionerSettings(url="localhost:11434", model="eyes")
    (tmp_path / "key").write_text("secret\n")
    monkeypatch.setenv("FASTSPLAT_CAPTIONER__URL", "http://localhost:11434/v1")
    monkeypatch.setenv("FASTSPLAT_CAPTIONER__MODEL", "eyes")
    monkeypatch.setenv("FASTSPLAT_CAPTIONER__KEY_FILE", str(tmp_path / "key"))
    with configured(tmp_path):
        captioner = load_settings().captioner
    assert (captioner.host, captioner.key) == ("localhost:11434", "secret") and "secret" not in repr(captioner)


@pytest.fixture
def nameless(models_dir: Path, tmp_path: Path) -> Iterator[Nameless]:
    with nameless_sample(models_dir, tmp_path) as opened:
        yield opened


def test_a_poster_that_says_what_to_say_names_nothing(nameless: Nameless) -> None:
    with client_of(nameless.faces) as client:
        sheets, before = list(client.contact_sheets(nameless.scene_id)), client.scene(nameless.scene_id).version
        with replayed(
            sheets, lambda sheet: named(sheet, {obj.object_id: "cat" for obj in sheet.objects}, 1.0)
        ) as server:
            said = suggest_by(client, nameless.scene_id, Captioner(server.url, "obeys"))
        assert server.got and said.names == () and said.refused == said.objects
        assert client.scene(nameless.scene_id).version == before
        (answer,) = client.query(nameless.scene_id, "cat")
        assert answer.outcome == "cannot_say"  # objects without a name may be it


def test_the_command_asks_and_says_what_came(nameless: Nameless, tmp_path: Path) -> None:
    with client_of(nameless.faces) as client:
        sheets = list(client.contact_sheets(nameless.scene_id))
    key = tmp_path / "captioner.key"
    key.write_text("secret\n")
    server_url = str(nameless.faces.rest.base_url)
    with replayed(sheets, lambda sheet: named(sheet, nameless.truth)) as server:
        command = ["objects", "ask-captioner", nameless.scene_id, server.url, "eyes", "--captioner-key", str(key)]
        done = invoke(*command, "--server", server_url)
        assert done.exit_code == 0, (done.output, done.exception)
    count = sum(len(sheet.objects) for sheet in sheets)
    assert f"{len(nameless.truth)} names suggested for {count} objects" in done.stdout
    assert [headers["authorization"] for _, headers, _ in server.got] == ["Bearer secret"] * len(sheets)
    with client_of(nameless.faces) as client:
        listed = {obj.id: obj for obj in client.objects(nameless.scene_id)}
    for obj, name in nameless.truth.items():
        assert listed[obj].name == "" and name in [guess.name for guess in listed[obj].suggestions]
