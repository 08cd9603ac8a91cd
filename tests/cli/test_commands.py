"""Each command says the same of a data folder and of a server, in REST's words, within 80 columns."""

from __future__ import annotations

import json
import re
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest
import typer
from rich.cells import cell_len
from typer.testing import Result

from fastsplat.cli.main import app
from fastsplat.cli.scenes.object_commands import _seen
from fastsplat.cli.tables import WIDTH
from fastsplat.service.application.service import open_service
from fastsplat.service.settings import load_settings
from fastsplat_contract.codec.json_codec import from_json, to_json, to_plain
from fastsplat_contract.errors import FastSplatError, InvalidInputError, NotFoundError, NotReadyError
from fastsplat_contract.jobs.look_again import FoundName, LookAgainResult
from fastsplat_contract.jobs.name_suggestions import SuggestedName, SuggestIn
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.photos.photo_verdicts import PhotoVerdict
from tests.api.made_scene import PLAIN_PNG, add_known_name, add_scene
from tests.api.served import serving
from tests.api.training_job import add_cancelled_job
from tests.api.upright_scene import add_upright_scene
from tests.cli.conftest import FREE_PORTS, configured
from tests.commands import invoke
from tests.scenes import claimed_job

LONG = "a name that nobody should give, 名前 " * 10  # more letters than any terminal has columns
_SERVICE = {"--server", "--key-file", "--ca", "--data", "--project"}
_GROUPS = ("scenes", "objects", "jobs", "keys", "projects")
_ENDLESS = {("mcp",)}  # they go on until they are stopped, and print no value


class Home(NamedTuple):
    """A data folder, a server over it, and what is there, by short names."""

    url: str
    key: str
    ids: dict[str, str]
    folder: Path

    def run(self, words: str, *more: str, server: bool = False) -> Result:
        """A command, asked of the folder or of the server; `$scene` in it is an id."""
        typed = [self.ids[word[1:]] if word.startswith("$") else word for word in words.split()]
        options = ["--server", self.url] if server else []
        return invoke(*typed, *more, *options, env={"FASTSPLAT_KEY": self.key})

    def json(self, words: str, *more: str, server: bool = False) -> Any:
        done = self.run(words, *more, "--json", server=server)
        assert done.exit_code == 0, (done.output, done.exception)
        return json.loads(done.stdout)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Home]:
    folder = tmp_path_factory.mktemp("home")
    with configured(folder):
        settings = load_settings().model_copy(update=FREE_PORTS)
        with open_service(settings) as service:
            ids = {"scene": add_scene(service, settings, LONG[:200]), "upright": add_upright_scene(service, settings)}
            claim = claimed_job(service._store)
            lost = PhotoVerdict(LONG, False, "no_overlap", ("blurred",), "", 0.3, 0.8, 0, LONG)
            service._store.jobs.record_photos(claim, [to_plain(lost)])
            error = {"kind": "INTERNAL", "reason": "X", "message": LONG, "stage": "training", "details": {}}
            service._store.jobs.fail(claim, error)
            ids |= {"failed": claim.operation.id, "failed_scene": claim.operation.scene_id}
            log = service._store.blobs.log(claim.operation.id)
            log.parent.mkdir(exist_ok=True)
            log.write_text(LONG)
            ids["cancelled"] = add_cancelled_job(service, "a.jpg")
            ids["name"] = add_known_name(service, ids["scene"], LONG[:200])
            ids["done"] = service.get_scene(ids["scene"]).operation_id
            record, _ = service.admin.keys.create(LONG[:200], "reader", 9_000.0)
            _, key = service.admin.keys.create("boss", "operator")
            ids["key"] = record.id
            (folder / "plain.png").write_bytes(PLAIN_PNG)
            with serving(service, settings) as ports:
                yield Home(f"http://127.0.0.1:{ports.http}", key, ids, folder)


LOOKING = (  # commands that change nothing
    "scenes list", "scenes show $scene", "scenes photos $failed_scene", "scenes next-photos $scene",
    "scenes observations $scene", "scenes clean $scene --isolation-above 1.2 --preview", "jobs list",
    "jobs list --state failed --limit 1", "jobs show $failed", "jobs watch $done", "jobs log $failed",
    "projects list", "keys list", "objects list $scene", "objects detections $upright", "objects goal $upright 1",
    "objects goal $scene 1", "objects pick $scene --view front.png --pixel 15.5 18.5", "objects measure $scene 1 2",
    "objects versions $scene", "objects known", "ask $scene mug", "ask $scene elephant ball --from front.png",
    "status",
)  # fmt: skip
TABLES = ("list", "photos", "versions", "detections", "known")
BY_REST = {
    "scenes list": "/v1/scenes",
    "scenes show $scene": "/v1/scenes/{scene}",
    "scenes photos $failed_scene": "/v1/scenes/{failed_scene}/photo-verdicts",
    "scenes next-photos $scene": "/v1/scenes/{scene}/next-photos",
    "jobs list": "/v1/operations",
    "jobs show $failed": "/v1/operations/{failed}",
    "keys list": "/v1/keys",
    "objects list $scene": "/v1/scenes/{scene}/objects",
    "objects detections $upright": "/v1/scenes/{upright}/detections",
    "objects versions $scene": "/v1/scenes/{scene}/versions",
    "objects known": "/v1/known-names",
    "projects list": "/v1/projects",
    "status": "/v1/server/status",
}


def _commands() -> dict[tuple[str, ...], Any]:
    waiting: list[tuple[tuple[str, ...], Any]] = [((), typer.main.get_command(app))]
    ends = {}
    while waiting:
        words, command = waiting.pop()
        inner = getattr(command, "commands", None)
        if inner is None:
            ends[words] = command
        else:
            waiting += [((*words, name), child) for name, child in inner.items()]
    return ends


def test_every_command_about_what_is_stored_takes_a_server_a_folder_and_json() -> None:
    commands = {words: leaf for words, leaf in _commands().items() if words[0] in (*_GROUPS, "ask", "status", "mcp")}
    assert len(commands) > 40
    for words, command in commands.items():
        options = {name for parameter in command.params for name in parameter.opts}
        assert options >= _SERVICE, words
        assert ("--json" in options) != (words in _ENDLESS), words


@pytest.mark.parametrize("words", LOOKING)
def test_a_folder_and_a_server_are_told_of_alike_and_tables_fit(words: str, home: Home) -> None:
    here, there = home.run(words), home.run(words, server=True)
    assert (here.exit_code, here.stderr) == (there.exit_code, there.stderr)
    assert _without_free_space(here.stdout) == _without_free_space(there.stdout)
    assert str(here.exception) == str(there.exception) and type(here.exception) is type(there.exception)
    assert here.exit_code == 0 or isinstance(here.exception, FastSplatError), here.exception
    if words.split()[:2][-1] in TABLES:
        assert all(cell_len(line) <= WIDTH for line in here.stdout.splitlines())


def _without_free_space(printed: str) -> str:
    """What other programs of this machine change between two answers."""
    return re.sub(r"(?m)^(disk +).*? of ", r"\1", printed)


def _close(left: Any, right: Any) -> bool:
    """Equal, but for the last digits of numbers: whoever reads a rotation makes it one of length 1."""
    if isinstance(left, dict) and isinstance(right, dict):
        return left.keys() == right.keys() and all(_close(left[name], right[name]) for name in left)
    if isinstance(left, list) and isinstance(right, list):
        return len(left) == len(right) and all(map(_close, left, right))
    return bool(left == pytest.approx(right, rel=1e-12, abs=1e-12) if isinstance(left, float) else left == right)


@pytest.mark.parametrize("words", BY_REST)
def test_json_is_that_of_rest(words: str, home: Home) -> None:
    path = BY_REST[words].format(**home.ids)
    sent = httpx.get(home.url + path, headers={"Authorization": f"Bearer {home.key}"}, params={"page_size": 500})
    by_command, by_rest = home.json(words, server=True), sent.json()
    if words == "status":
        del by_command["health"]["disk"]["free_bytes"], by_rest["health"]["disk"]["free_bytes"]
    assert _close(by_command, by_rest)


def test_files_are_the_same_of_a_folder_and_of_a_server(home: Home) -> None:
    for name in ("a.ply", "b.spz"):
        written = [home.folder / f"{server}-{name}" for server in (False, True)]
        for server, file in enumerate(written):
            assert home.run("scenes export $scene", str(file), server=bool(server)).exit_code == 0
        assert written[0].read_bytes() == written[1].read_bytes() != b""


def test_a_photo_without_a_place_is_said_and_ends_with_1(home: Home) -> None:
    for server in (False, True):
        done = home.run("scenes localize $scene", str(home.folder / "plain.png"), server=server)
        assert done.exit_code == 1 and done.stdout.startswith("plain.png: "), done.exception


def test_ids_are_taken_in_short_and_ambiguous_ones_are_refused(home: Home) -> None:
    whole = home.json("scenes show $scene")
    for server in (False, True):
        assert home.json("scenes show", home.ids["scene"][:8], server=server) == whole
    assert home.json("jobs show", home.ids["failed"][:8], server=True)["id"] == home.ids["failed"]
    share = home.json("keys share", home.ids["scene"][:8], server=True)
    revoked = home.json("keys revoke", share["key"]["id"][:8], server=True)
    assert (revoked["state"], revoked["scene_id"]) == ("REVOKED", home.ids["scene"])
    assert isinstance(home.run("scenes show zzzz", server=True).exception, NotFoundError)
    assert isinstance(home.run("jobs show", home.ids["failed"][:1], server=True).exception, InvalidInputError)


def test_what_is_changed_by_a_server_is_changed_in_its_folder(home: Home) -> None:
    ids = home.ids
    assert home.run("scenes rename $upright desk", server=True).exit_code == 0
    assert home.json("scenes show $upright")["name"] == "desk"
    version = home.json("objects name $upright violin 1", server=True)["version"]
    assert home.json("objects list $upright")["objects"][0]["name"] == "violin"
    undone = home.run("objects undo $upright --version", version[:6], server=True)
    assert undone.exit_code == 0 and undone.stdout.endswith("is current\n")
    again = home.run("objects redo $upright")
    assert again.stdout == f"version {version} is current\n"
    home.run("objects undo $upright", server=True)
    sheet = home.folder / "sheet.jpg"
    none = home.run("objects sheet $upright", str(sheet))
    assert none.stderr == "no object is without a name\n" and not sheet.exists()
    home.run("objects unname $upright 1", server=True)
    reply = home.json("objects sheet $upright", str(sheet))
    assert [obj["object_id"] for obj in reply["objects"]] == [1] and sheet.read_bytes() == b64decode(reply["picture"])
    table = home.run("objects sheet $upright", str(sheet), server=True).stdout
    assert table.split()[:2] == ["no.", "id"] and "2 floor" in table
    home.run("objects undo $upright", server=True)
    file = home.folder / "told.json"
    names = [SuggestedName(1, "moon", 0.9, "eyes"), SuggestedName(2, "carrot", 0.3, "eyes")]
    file.write_bytes(to_json(SuggestIn(tuple(names))))
    assert "2 names suggested" in home.run("objects suggest $upright", str(file), server=True).stdout
    listed = home.json("objects list $upright")["objects"]
    assert {"moon", "carrot"} <= {suggestion["name"] for obj in listed for suggestion in obj["suggestions"]}
    unnamed = [obj["id"] for obj in listed if not obj["name"]]
    confirmed = home.json("objects confirm $upright --least .2", server=True)["objects"]
    assert [obj["id"] for obj in confirmed] == [object_id for object_id in unnamed if object_id in (1, 2)]
    assert all(obj["name"] for obj in home.json("objects list $upright")["objects"] if obj["id"] in (1, 2))
    file.write_text("{}")
    assert isinstance(home.run("objects suggest $upright", str(file), server=True).exception, InvalidInputError)
    assert home.json("jobs retry $cancelled --exclude", "another.jpg", server=True)["state"] == "QUEUED"
    assert home.json("jobs cancel $cancelled")["state"] == "CANCELLED"
    new_key = home.json("keys create robot --role reader", server=True)
    assert {key["id"]: key["state"] for key in home.json("keys list")["keys"]}[new_key["key"]["id"]] == "VALID"
    assert home.json("keys revoke", new_key["key"]["id"][:6])["state"] == "REVOKED"
    assert home.json("projects create kitchen", server=True)["name"] == "kitchen"
    assert [project["name"] for project in home.json("projects list")["projects"]] == ["default", "kitchen"]
    sample = home.json("scenes sample", server=True)["id"]
    assert home.json("scenes sample")["id"] == sample  # once for both
    assert home.run("scenes delete", sample, "--yes").exit_code == 0
    assert home.run("scenes delete $failed_scene", server=True).exit_code == 1  # nobody said yes
    assert home.run("scenes delete $failed_scene --yes", server=True).exit_code == 0
    assert isinstance(home.run("scenes show", ids["failed_scene"]).exception, NotFoundError)


def test_what_came_of_a_job_is_said_in_a_line_or_two(home: Home) -> None:
    done = from_json(Operation, home.run("jobs show $done --json", server=True).stdout)
    again = LookAgainResult("e12", ("cup",), ("a.jpg",), False, (FoundName(1, "cup", 0.5),), (), 3, 2)
    assert _seen(replace(done, look_again=again)).splitlines() == [
        "object 1 is cup (50%)",
        "2 of 3 regions are no object of the scene",
        "version e12 is there",
    ]


def test_a_question_is_answered_by_its_sentence_first(home: Home) -> None:
    answers = home.json("ask $scene mug elephant")["answers"]
    said = home.run("ask $scene mug elephant").stdout.splitlines()
    assert said[0] == answers[0]["sentence"] and answers[1]["sentence"] in said[1:]
    assert said[1].startswith("  object 1, mug, at (")


def test_a_folder_stands_for_its_newest_scene(home: Home) -> None:
    data = str(home.folder / "data")
    newest = home.json("scenes list", server=True)["scenes"][0]
    assert newest["state"] != "READY"
    for words in ("scenes show", "objects list", "ask"):
        refused = home.run(words, data, *(["mug"] if words == "ask" else [])).exception
        assert isinstance(refused, NotReadyError) and "not been trained" in refused.message
    assert isinstance(home.run("scenes show", data, server=True).exception, NotFoundError)


def test_what_names_no_service_is_refused(home: Home, tmp_path: Path) -> None:
    both = home.run("scenes list --data", str(tmp_path), server=True)
    assert isinstance(both.exception, InvalidInputError) and both.exception.field == "--data"
    assert isinstance(home.run("scenes list --data", str(tmp_path / "none")).exception, NotFoundError)
    assert not (tmp_path / "none").exists()
    no_key = home.run("scenes list --key-file", str(tmp_path / "none"), server=True)
    assert isinstance(no_key.exception, InvalidInputError) and no_key.exception.field == "--key-file"
