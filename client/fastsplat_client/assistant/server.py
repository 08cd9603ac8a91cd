"""The MCP server: each tool's name, its description for a model that has never seen the service, and its errors."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Annotated, Any, TypeVar

from mcp.server.mcpserver import Context, Image, MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from mcp_types import ToolAnnotations
from pydantic import Field

from fastsplat_client.assistant import tool_results, tools
from fastsplat_client.assistant.look_from import look_from as picture_from
from fastsplat_client.client import Client
from fastsplat_contract.errors import FastSplatError

T = TypeVar("T")
ClientOf = Callable[[Any], contextlib.AbstractContextManager[Client]]
"""Makes the client of the caller whose HTTP request, or None, is given."""

_INSTRUCTIONS = """Questions to 3D scenes made of photos: what is there, where, how large, how far apart.

- `find` first. Its verdict is the answer: exact, related (something close; its label says what), or absent. Say an
  absence as one; unnamed things are told beside it, as one of them may be what was asked for.
- Say lengths in meters only where unit is "m". Where it is "scene units" only ratios mean anything.
- Probabilities are calibrated: 0.6 is wrong 4 times in 10.
- Left, right, in front and behind need `view`, the place they are seen from.
- A refusal is an answer: its text says what is wrong and what helps."""

_Scene = Annotated[str, Field(description="id or name of the scene; may be left out where only one is ready")]
_Text = Annotated[str, Field(description="what is looked for, in plain words: a name, a kind, a use")]
_Thing = Annotated[int, Field(ge=0, le=65535, description="id of a thing, as other tools return it")]
_READS = ToolAnnotations(read_only_hint=True, open_world_hint=False)
_CHANGES = ToolAnnotations(read_only_hint=False, destructive_hint=False, idempotent_hint=True, open_world_hint=False)


def assistant_server(client_of: ClientOf, version: str = "") -> MCPServer[Any]:
    """The tools as an MCP server.

    Args:
        client_of: whom a call asks, under whose key. Its argument is the HTTP request that brought the call, None on
            standard input.
        version: of the service, for those who ask.
    """
    server: MCPServer[Any] = MCPServer(
        "fastsplat", title="FAST-Splat scenes", instructions=_INSTRUCTIONS, version=version, log_level="WARNING"
    )

    def answered(context: Context[Any, Any], call: Callable[[Client], T]) -> T:
        with _refusals_word_for_word(), client_of(context.request_context.request) as client:
            return call(client)

    @server.tool(annotations=_READS)
    def list_scenes(context: Context[Any, Any]) -> list[tool_results.SceneInList]:
        """All scenes of the project, newest first, with state (only READY ones can be asked) and unit of length."""
        return answered(context, tools.list_scenes)

    @server.tool(annotations=_READS)
    def describe_scene(context: Context[Any, Any], scene: _Scene = "") -> tool_results.SceneDescription:
        """What a scene holds: names with counts, unnamed things, extent, unit of length, what is up, and its grade."""
        return answered(context, lambda client: tools.describe_scene(client, scene))

    @server.tool(annotations=_READS)
    def list_things(
        context: Context[Any, Any],
        scene: _Scene = "",
        name: Annotated[str, Field(description="only things that bear this name; empty: all")] = "",
        limit: Annotated[int, Field(ge=1, le=500, description="at most so many")] = 100,
    ) -> tool_results.Things:
        """Things of a scene with id, name, probability of the name, center and size."""
        return answered(context, lambda client: tools.list_things(client, scene, name, limit))

    @server.tool(annotations=_READS)
    def find(context: Context[Any, Any], text: _Text, scene: _Scene = "") -> tool_results.Found:
        """Is there such a thing, and what is it called here? Also by kind and use ("something to drink from")."""
        return answered(context, lambda client: tools.find(client, text, scene))

    @server.tool(annotations=_READS)
    def where_is(context: Context[Any, Any], text: _Text, scene: _Scene = "") -> tool_results.Where:
        """Where a thing is, with 95 % bounds, its size, and the photos that show it best; nothing if it is absent."""
        return answered(context, lambda client: tools.where_is(client, text, scene))

    @server.tool(annotations=_READS)
    def count(context: Context[Any, Any], text: _Text, scene: _Scene = "") -> tool_results.Count:
        """How many there are, with their ids: of a name ("mugs"), or by all that is said ("cups on the table")."""
        return answered(context, lambda client: tools.count(client, text, scene))

    @server.tool(annotations=_READS)
    def relations(
        context: Context[Any, Any],
        text: Annotated[
            str,
            Field(
                description='a question about how or where things are: "the mug left of the lamp", "what is on the '
                'table?", "the largest book", "the second cup from the left"'
            ),
        ],
        view: Annotated[
            str,
            Field(description="name of the photo from whose place left, right, in front and behind are meant"),
        ] = "",
        scene: _Scene = "",
    ) -> tool_results.Related:
        """Which things stand in a relation, have a color or a size, by measurement; or why that cannot be decided."""
        return answered(context, lambda client: tools.relations(client, text, scene, view))

    @server.tool(annotations=_READS)
    def measure(
        context: Context[Any, Any],
        first: _Thing,
        second: Annotated[int, Field(ge=0, le=65535, description="id of another thing; 0: the size of the first")] = 0,
        scene: _Scene = "",
    ) -> tool_results.Measured:
        """How far two things are from each other, or how large one is, with 95 % intervals."""
        return answered(context, lambda client: tools.measure(client, first, second, scene))

    @server.tool(annotations=_READS)
    def goal(
        context: Context[Any, Any],
        thing: Annotated[int, Field(ge=1, le=65535, description="id of the thing to see, as other tools return it")],
        robot_radius: Annotated[float, Field(gt=0, le=5, description="of the robot, meters")] = 0.2,
        scene: _Scene = "",
    ) -> tool_results.StandingPlace:
        """Where a robot stands to see a thing: the nearest free place on the floor, and which way to look. Refused for
        scenes without meters or a known vertical, and where no such place was seen."""
        return answered(context, lambda client: tools.goal(client, thing, robot_radius, scene))

    @server.tool(annotations=_READS, structured_output=False)
    def look_from(
        context: Context[Any, Any],
        thing: Annotated[int, Field(ge=0, le=65535, description="id of a thing to tint orange; 0: none")] = 0,
        view: Annotated[str, Field(description="name of one of the scene's photos to look from")] = "",
        position: Annotated[
            tuple[float, float, float] | None, Field(description="x, y, z to stand at, instead of view")
        ] = None,
        target: Annotated[
            tuple[float, float, float] | None, Field(description="x, y, z to look at, with position")
        ] = None,
        scene: _Scene = "",
    ) -> Image:
        """A picture of the scene: from where a thing is seen best, from one of its photos, or from any place."""
        jpeg = answered(context, lambda client: picture_from(client, scene, thing, view, position, target))
        return Image(data=jpeg, format="jpeg")

    @server.tool(annotations=_CHANGES)
    def name_thing(
        context: Context[Any, Any],
        thing: _Thing,
        name: Annotated[str, Field(description="what the user calls it")],
        aliases: Annotated[list[str] | None, Field(description="other names of the same")] = None,
        scene: _Scene = "",
    ) -> tool_results.Named:
        """Give a thing its name, when the user says what it is; it is then found by that name and by its meaning."""
        return answered(context, lambda client: tools.name_thing(client, thing, name, aliases or [], scene))

    @server.tool(annotations=_READS)
    def photograph_next(context: Context[Any, Any], scene: _Scene = "") -> tool_results.NextPhotos:
        """Where the user should stand for the photos that would improve the scene most."""
        return answered(context, lambda client: tools.photograph_next(client, scene))

    @server.tool(annotations=_READS)
    def scene_status(context: Context[Any, Any], scene: _Scene = "") -> tool_results.JobStatus:
        """How far a scene's training is, how long it still takes, and why it failed if it did."""
        return answered(context, lambda client: tools.scene_status(client, scene))

    return server


@contextlib.contextmanager
def _refusals_word_for_word() -> Iterator[None]:
    """The service's refusals as the tool's: MCP hides what any other exception says."""
    try:
        yield
    except FastSplatError as error:
        details = "".join(f" {name}: {value}." for name, value in error.details().items() if name != "hint")
        raise ToolError(f"{error.reason}: {error.message}.{details} {error.hint}".strip()) from error
