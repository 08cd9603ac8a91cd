"""Score an assistant's tools on 200 questions with a known truth, without a language model.

    python -m benchmarks.assistant [--models DIR] [--misses]

The two rooms of `rooms.py` are stored in a service of their own, and every question of `questions.txt` is asked by the
official MCP client over HTTP of a real server process, one after another. Writes benchmarks/results/assistant.json:
  right: share of the answers that are the truth (`questions.py` says what that is), over all, by tool, by kind;
  absent_said: share of the `absent` questions that are said to be so;
  absent_named_exact: how many of these are said to be there, not merely close to something that is;
  intervals_true: share of the 95 % intervals of measured lengths that hold the truth;
  p50_ms, p95_ms: of a call, by tool and over all; first_ms: of the first to each room, which opens it;
    the others are without it.
Intervals are 95 % (Wilson). The truth comes from how objects were placed.
"""

from __future__ import annotations

import asyncio
import dataclasses
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
from mcp import Client as McpClient
from mcp.client.streamable_http import streamable_http_client

from benchmarks.assistant.questions import Question, is_right, lengths, read_questions
from benchmarks.assistant.rooms import Layout, layouts
from benchmarks.provenance import NOT_CHOSEN, begin, parser_of, write_results
from benchmarks.relations.__main__ import share_right
from benchmarks.serve.api_process import Api
from benchmarks.serve.stored_scenes import add_scene
from fastsplat.service.perception.lexicon.wordnet import find_lexicon
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.language.meaning.embeddings import embed_labels
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import open_store
from tests.query.placed_rooms import scene_of

_TIMEOUT_S = 60.0


@dataclass(frozen=True)
class Answered:
    """A question and what the tool said.

    Attributes:
        question: that was asked.
        right: whether that is the truth.
        said: the structured result, {} for an error.
        error: its text; "" for none.
        milliseconds: of the call.
        bounded: whether each interval of a measurement holds the truth.
    """

    question: Question
    right: bool
    said: Mapping[str, Any]
    error: str
    milliseconds: float
    bounded: tuple[bool, ...] = ()


def stored_rooms(settings: Settings, rooms: Sequence[Layout]) -> dict[str, str]:
    """Store the rooms as finished trainings leave scenes; their ids, by name."""
    encoder = open_text_encoder(settings.perception.text_encoder, settings.models)
    store = open_store(settings.data_dir, settings.database_url)
    try:
        ids = {}
        for seed, layout in enumerate(rooms):
            drawn: Scene = scene_of(layout.room, seed, layout.world)
            scene = dataclasses.replace(
                drawn,
                label_embeddings=embed_labels(drawn.dictionary, encoder, settings.query.templates),
                label_templates=settings.query.templates,
                text_encoder=(encoder.name, encoder.sha256),
            )
            ids[layout.name] = add_scene(store, scene)
        return ids
    finally:
        store.close()


async def ask_all(
    url: str, headers: Mapping[str, str], questions: Sequence[Question], rooms: Sequence[Layout], ids: Mapping[str, str]
) -> tuple[list[Answered], list[float]]:
    """The answers in order, and milliseconds of the first call to each room.

    Args:
        url: of the server's /mcp.
        headers: with a key.
        questions: what to ask.
        rooms: layouts that the questions are about.
        ids: of the stored scenes, by room.
    """
    by_name = {layout.name: layout for layout in rooms}
    async with (
        httpx2.AsyncClient(headers=dict(headers), timeout=_TIMEOUT_S) as http,
        McpClient(streamable_http_client(url, http_client=http)) as client,
    ):
        first = []
        for layout in rooms:
            opened = await _ask(client, Question(layout.name, "find", layout.room.objects[0].name), layout, ids)
            first.append(opened.milliseconds)
        answered = [await _ask(client, question, by_name[question.room], ids) for question in questions]
    return answered, first


async def _ask(client: McpClient, question: Question, layout: Layout, ids: Mapping[str, str]) -> Answered:
    begun = time.perf_counter()
    result = await client.call_tool(question.tool, {**question.arguments(), "scene": ids[question.room]})
    milliseconds = 1e3 * (time.perf_counter() - begun)
    if result.is_error or result.structured_content is None:
        return Answered(question, False, {}, str(result.content), milliseconds)
    said = result.structured_content
    measured = lengths(question, said, layout) if question.tool == "measure" else []
    bounded = tuple(length["low"] <= truth <= length["high"] for length, truth in measured)
    return Answered(question, is_right(question, said, layout), said, "", milliseconds, bounded)


def figures(answered: Sequence[Answered]) -> dict[str, Any]:
    """The figures of the module's description, without `first_ms`."""
    return {
        "right": share_right([reply.right for reply in answered]),
        "by_tool": _grouped(answered, lambda reply: reply.question.tool),
        "by_kind": _grouped(answered, lambda reply: reply.question.kind),
        "absent_said": share_right([reply.right for reply in answered if reply.question.kind == "absent"]),
        "absent_named_exact": sum(
            reply.question.kind == "absent" and reply.said.get("outcome") == "here" for reply in answered
        ),
        "intervals_true": share_right([bounded for reply in answered for bounded in reply.bounded]),
        **_latency(answered),
        "latency_by_tool": {
            tool: _latency([reply for reply in answered if reply.question.tool == tool])
            for tool in sorted({reply.question.tool for reply in answered})
        },
    }


def _grouped(answered: Sequence[Answered], key: Callable[[Answered], str]) -> dict[str, dict[str, Any]]:
    groups: defaultdict[str, list[bool]] = defaultdict(list)
    for reply in answered:
        groups[key(reply)].append(reply.right)
    return {name: share_right(groups[name]) for name in sorted(groups)}


def _latency(answered: Sequence[Answered]) -> dict[str, float]:
    p50, p95 = np.percentile([reply.milliseconds for reply in answered], [50, 95])
    return {"p50_ms": round(float(p50), 1), "p95_ms": round(float(p95), 1)}


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--models", type=Path, default=Path(os.environ.get("FASTSPLAT_MODELS", ".models")))
    parser.add_argument("--misses", action="store_true", help="print what is not right")
    options = parser.parse_args()
    start = begin()
    rooms = layouts()
    questions = read_questions(rooms)
    with tempfile.TemporaryDirectory(prefix="fastsplat-assistant-") as folder:
        settings = Settings(data_dir=Path(folder) / "data", models=options.models.resolve())
        lexicon = find_lexicon(settings.perception.lexicon, settings.models)
        ids = stored_rooms(settings, rooms)
        with Api(settings, {}) as api:
            headers = {"Authorization": f"Bearer {api.key}"}
            url = f"http://127.0.0.1:{api.http_port}/mcp"
            answered, first = asyncio.run(ask_all(url, headers, questions, rooms, ids))
    for reply in answered if options.misses else ():
        if not reply.right:
            question = reply.question
            print(f"{question.room}, {question.kind}: {question.text!r} {question.names} {question.objects}")
            print(f"  but {reply.error or dict(reply.said)}")
    document = {
        "encoder": settings.perception.text_encoder,
        "lexicon": settings.perception.lexicon if lexicon else "",
        **figures(answered),
        "first_ms": [round(milliseconds, 1) for milliseconds in first],
    }
    for name in (
        "lexicon",
        "right",
        "absent_said",
        "absent_named_exact",
        "intervals_true",
        "p50_ms",
        "p95_ms",
        "first_ms",
    ):
        print(name, document[name])
    for kind, share in document["by_kind"].items():
        print(f"  {kind}: {share['right']} of {share['questions']}")
    write_results("assistant", start, options, NOT_CHOSEN, document)


if __name__ == "__main__":
    _main()
