"""Tools with which an assistant looks at objects without a name, and suggests names for them."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Annotated

from mcp.server.mcpserver import Image
from mcp_types import CallToolResult, TextContent
from pydantic import ConfigDict, Field

from fastsplat_client.assistant.tool_results import Unit
from fastsplat_client.assistant.tools import SCENE_ID, SceneName, resolve_scene
from fastsplat_client.client import Client
from fastsplat_contract import calls
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.jobs.name_suggestions import SuggestedName
from fastsplat_contract.messages.contact_sheets import SheetObject
from fastsplat_contract.messages.requests import GetContactSheetRequest


@dataclass(frozen=True)
class UnnamedObjects:
    """Objects without a name, by their numbers in the picture. No photo shows those of `unseen`, given by their ids.
    `next_page` is empty on the last page."""

    scene: str
    unit: Unit
    objects: list[SheetObject]
    unseen: list[int]
    next_page: str


@dataclass(frozen=True)
class NameGuess:
    """What an object may be."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    object_id: Annotated[int, Field(ge=1, le=65535, description="id of the object, not its number in the picture")]
    name: Annotated[str, Field(description="what it is, in a word or two")]
    probability: Annotated[float, Field(ge=0, le=1, description="that this is right: 0.6 is wrong 4 times in 10")]
    aliases: Annotated[list[str], Field(description="other words for the same")] = field(default_factory=list)


@dataclass(frozen=True)
class Suggested:
    """How many names were suggested. `version` is the scene's new version, which can be undone; no object bears any of
    these names until a person confirms it."""

    scene: str
    suggested: int
    version: str


def unnamed_objects(
    client: Client,
    page: Annotated[str, Field(description="next_page of the answer before; empty: the first")] = "",
    scene: SceneName = "",
) -> Annotated[CallToolResult, UnnamedObjects]:
    """A picture of up to 20 objects that have no name, each outlined and numbered, with their ids, sizes and
    neighbors. Say what you recognize by suggest_names, then ask for the next page."""
    scene_id = _resolved(client, scene)
    sheet = client.call(calls.GET_CONTACT_SHEET, GetContactSheetRequest(scene_id, page_token=page))
    unit: Unit = "m" if sheet.meters else "scene units"
    listed = UnnamedObjects(scene_id, unit, list(sheet.objects), list(sheet.unseen), sheet.next_page_token)
    plain = to_plain(listed)
    text = TextContent(type="text", text=json.dumps(plain, ensure_ascii=False))
    pictures = [Image(data=sheet.picture, format="jpeg").to_image_content()] if sheet.picture else []
    return CallToolResult(content=[*pictures, text], structured_content=plain)


def suggest_names(
    client: Client,
    names: Annotated[
        list[NameGuess],
        Field(min_length=1, max_length=1_000, description="what you recognize; nothing of objects that you do not"),
    ],
    source: Annotated[
        str, Field(min_length=1, max_length=60, description="who you are, the same in every call: your product's name")
    ],
    model: Annotated[str, Field(description="your model and its version, if you know them")] = "",
    scene: SceneName = "",
) -> Suggested:
    """Suggest names for objects by what you see in pictures of them. They can be asked for, and are shown as yours;
    an object bears one only after a person confirmed it. What you said of an object before is replaced."""
    scene_id = _resolved(client, scene)
    suggestions = [
        SuggestedName(guess.object_id, guess.name, guess.probability, source, model, tuple(guess.aliases))
        for guess in names
    ]
    new_version = client.suggest_names(scene_id, suggestions)
    return Suggested(scene_id, len(suggestions), new_version.version)


def _resolved(client: Client, scene: str) -> str:
    """The id of the scene of that id or name; an id is taken as it is, for keys that may not look at scenes."""
    return scene if SCENE_ID.fullmatch(scene) else resolve_scene(client, scene).id
