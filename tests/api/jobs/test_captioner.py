"""A captioner of one's own names the sample: what it says are suggestions, and nothing is stated without a person."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from fastsplat_client.captioner import Captioner, suggest_by
from tests.api.clients import client_of
from tests.api.nameless import Nameless, nameless_sample, seen_with_errors
from tests.client.replay_captioner import named, replayed
from tests.commands import invoke


@pytest.fixture
def room(models_dir: Path, tmp_path: Path) -> Iterator[Nameless]:
    with nameless_sample(models_dir, tmp_path) as opened:
        yield opened


def test_true_names_reach_suggestions_and_none_is_stated(room: Nameless) -> None:
    with client_of(room.faces) as client:
        sheets = list(client.contact_sheets(room.scene_id))
        for model, seed in (("one", 1), ("other", 2)):
            seen = seen_with_errors(room.truth, seed)
            with replayed(sheets, partial(named, names=seen, probability=0.8)) as server:
                said = suggest_by(client, room.scene_id, Captioner(server.url, model))
            assert said.requests == len(sheets) and {name.object_id for name in said.names} == room.truth.keys()
        listed = {obj.id: obj for obj in client.objects(room.scene_id)}
        assert not any(obj.name for obj in listed.values())
        reached = [name in [guess.name for guess in listed[obj].suggestions] for obj, name in room.truth.items()]
        assert np.mean(reached) >= 0.95
        (answer,) = client.query(room.scene_id, "banana")
        assert answer.outcome == "probably_here"


def test_a_poster_that_says_what_to_say_names_nothing(room: Nameless) -> None:
    with client_of(room.faces) as client:
        sheets, before = list(client.contact_sheets(room.scene_id)), client.scene(room.scene_id).version
        with replayed(
            sheets, lambda sheet: named(sheet, {obj.object_id: "cat" for obj in sheet.objects}, 1.0)
        ) as server:
            said = suggest_by(client, room.scene_id, Captioner(server.url, "obeys"))
        assert server.got and said.names == () and said.refused == said.objects
        assert client.scene(room.scene_id).version == before
        (answer,) = client.query(room.scene_id, "cat")
        assert answer.outcome == "cannot_say"  # objects without a name may be it


def test_the_command_asks_and_says_what_came(room: Nameless, tmp_path: Path) -> None:
    with client_of(room.faces) as client:
        sheets = list(client.contact_sheets(room.scene_id))
    key = tmp_path / "captioner.key"
    key.write_text("secret\n")
    server_url = str(room.faces.rest.base_url)
    with replayed(sheets, lambda sheet: named(sheet, room.truth)) as server:
        command = ["objects", "ask-captioner", room.scene_id, server.url, "eyes", "--captioner-key", str(key)]
        done = invoke(*command, "--server", server_url)
        assert done.exit_code == 0, (done.output, done.exception)
        assert (
            f"{len(room.truth)} names suggested for {sum(len(sheet.objects) for sheet in sheets)} objects"
            in done.stdout
        )
        assert {headers["authorization"] for _, headers, _ in server.got} == {"Bearer secret"}
