"""An assistant names the sample from sheets, by the official client: suggestions until a person confirms them."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from mcp import Client as McpClient
from mcp_types import ImageContent, TextContent
from PIL import Image

from fastsplat_contract.errors import PermissionDeniedError
from fastsplat_contract.messages.scenes import Edit
from tests.api.clients import client_of
from tests.api.guarded import Guarded
from tests.api.made_scene import add_scene
from tests.api.nameless import Nameless, nameless_sample, seen_with_errors
from tests.api.programs.test_assistant import _call, _refusal, _said, _talk

_WRONG = {"one": 1, "other": 2}  # the seeds of what two stand-ins for an assistant see wrongly


@pytest.fixture(scope="module")
def room(models_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nameless]:
    with nameless_sample(models_dir, tmp_path_factory.mktemp("named")) as opened:
        yield opened


async def _name_all(client: McpClient, scene_id: str, source: str, guesses: Mapping[int, str]) -> tuple[int, list[int]]:
    """Name a scene from its sheets; returns the number of calls, and the objects that the pictures showed."""
    calls, page, seen = 0, "", []
    while True:
        result = await client.call_tool("unnamed_objects", {"scene": scene_id, "page": page})
        sheet = _said(result)
        picture, text = result.content
        assert isinstance(picture, ImageContent) and isinstance(text, TextContent)
        with Image.open(io.BytesIO(base64.b64decode(picture.data))) as image:
            assert image.format == "JPEG" and max(image.size) <= 768 and np.asarray(image).std() > 10
        assert [obj["number"] for obj in sheet["objects"]] == list(range(1, len(sheet["objects"]) + 1))
        seen += [obj["object_id"] for obj in sheet["objects"]]
        names = [
            {"object_id": obj["object_id"], "name": guesses[obj["object_id"]], "probability": 0.8}
            for obj in sheet["objects"]
            if obj["object_id"] in guesses
        ]
        arguments = {"names": names, "source": source, "model": "stand-in", "scene": scene_id}
        assert _said(await client.call_tool("suggest_names", arguments))["suggested"] == len(names)
        calls, page = calls + 2, sheet["next_page"]
        if not page:
            return calls, seen


def test_the_sample_is_named_from_sheets_in_few_calls_and_nothing_is_stated_without_a_person(room: Nameless) -> None:
    for source, seed in _WRONG.items():
        guesses = seen_with_errors(room.truth, seed)
        talk = partial(_name_all, scene_id=room.scene_id, source=source, guesses=guesses)
        calls, seen = _talk(room.faces, talk)
        assert calls <= 6 and len(seen) == len(set(seen)) and room.truth.keys() <= set(seen)
    with client_of(room.faces) as client:
        listed = {obj.id: obj for obj in client.objects(room.scene_id)}
        assert not any(obj.name for obj in listed.values())
        reached = [name in [guess.name for guess in listed[obj].suggestions] for obj, name in room.truth.items()]
        assert np.mean(reached) >= 0.95
        (answer,) = client.query(room.scene_id, "banana")
        assert answer.outcome == "probably_here"
        # A person takes what both say, at once.
        both = {obj.id for obj in listed.values() if obj.suggestions and obj.suggestions[0].probability >= 0.9}
        assert {obj.id for obj in client.confirm_names(room.scene_id, least=0.9)} == both
        named = {obj.id: obj.name for obj in client.objects(room.scene_id) if obj.name}
        right = [obj for obj, name in room.truth.items() if named.get(obj) == name]
        assert named.keys() == both and len(right) >= 0.95 * len(named) > 0.7 * len(room.truth)


def test_a_reader_may_look_and_suggests_nothing(guarded: Guarded) -> None:
    scene_id = add_scene(guarded.service, guarded.settings, "looked at")
    none = _call(guarded.faces, "unnamed_objects", guarded.header("reader"), scene=scene_id)
    assert _said(none)["objects"] == [] and len(none.content) == 1  # all have names: there is no picture
    version = guarded.service.versions.edit(scene_id, [Edit("unname", object_ids=(1,))]).version
    said = _said(_call(guarded.faces, "unnamed_objects", guarded.header("reader"), scene=scene_id))
    with client_of(guarded.faces, key=guarded.keys["reader"]) as client:
        on_sheets = [obj.object_id for sheet in client.contact_sheets(scene_id) for obj in sheet.objects]
        assert [obj["object_id"] for obj in said["objects"]] == on_sheets == [1]
    guess = {"object_id": 1, "name": "moon", "probability": 0.7}
    arguments = {"names": [guess], "source": "eyes", "scene": scene_id}
    assert "PERMISSION_DENIED" in _refusal(_call(guarded.faces, "suggest_names", guarded.header("reader"), **arguments))
    for wrong, field in ((guess | {"color": "red"}, "color"), (guess | {"probability": 2}, "probability")):
        refusal = _refusal(
            _call(guarded.faces, "suggest_names", guarded.header("editor"), **(arguments | {"names": [wrong]}))
        )
        assert "INVALID_INPUT" in refusal and f"names.0.{field}" in refusal
    assert guarded.service.get_scene(scene_id).version == version


def test_a_suggester_names_a_scene_of_which_it_knows_the_id_and_sees_nothing_else(guarded: Guarded) -> None:
    scene_id = add_scene(guarded.service, guarded.settings, "of a stranger")
    guarded.service.versions.edit(scene_id, [Edit("unname", object_ids=(1,))])
    said = _said(_call(guarded.faces, "unnamed_objects", guarded.header("suggester"), scene=scene_id))
    assert [obj["object_id"] for obj in said["objects"]] == [1] and said["unit"] == "m"
    arguments = {"names": [{"object_id": 1, "name": "moon", "probability": 0.7}], "source": "eyes", "scene": scene_id}
    assert _said(_call(guarded.faces, "suggest_names", guarded.header("suggester"), **arguments))["suggested"] == 1
    for tool, more in (("unnamed_objects", {"scene": "of a stranger"}), ("describe_scene", {"scene": scene_id})):
        assert "PERMISSION_DENIED" in _refusal(_call(guarded.faces, tool, guarded.header("suggester"), **more))
    with client_of(guarded.faces, key=guarded.keys["suggester"]) as client:
        status = client.server_status()
        assert (status.role, status.models, status.quotas, status.addresses) == ("suggester", (), (), ())
        with pytest.raises(PermissionDeniedError):
            client.confirm_names(scene_id)
        with pytest.raises(PermissionDeniedError):
            client.name_objects(scene_id, 1, "moon")
