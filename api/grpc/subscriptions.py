"""`StreamQuery`: answers a subscription at the newest pose, without a queue."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing, suppress
from dataclasses import dataclass, field, replace
from typing import Any

from google.protobuf import timestamp_pb2

from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat.service.query.ranked_scene import SubscribedQuery
from fastsplat_contract.codec.proto_codec import from_proto
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import pose_of
from fastsplat_contract.messages.pieces import messages_of
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.v1 import fastsplat_pb2 as pb

_SHORTEST_HEARTBEAT_S = 0.1
_LONGEST_HEARTBEAT_S = 300.0


@dataclass(frozen=True)
class _Question:
    number: int
    query: QueryRequest
    heartbeat_s: float
    ranking: SubscribedQuery = field(default_factory=SubscribedQuery)


@dataclass(frozen=True)
class _Pose:
    sequence: int
    camera: PosedCamera
    stamp: timestamp_pb2.Timestamp | None
    question: _Question


async def answer_stream(
    service: SceneService, threads: Threads, requests: AsyncIterator[pb.StreamQueryRequest]
) -> AsyncGenerator[pb.StreamQueryResponse]:
    """Yields the answers of a stream, see StreamQueryRequest in the contract.

    Memory is bounded: at most one pose, one question and one range of dropped sequence numbers wait. Raises
    `FastSplatError` if the stream, a question or a pose is invalid, or the scene is gone.
    """
    inbox = _Inbox(service.heartbeat_s)
    reading = asyncio.create_task(inbox.read(requests))
    try:
        while True:
            if not await inbox.wait():
                await threads.call(lambda: service.versions.resolve(inbox.scene_id))  # raises if the scene is gone
                yield _heartbeat(inbox.number)
                continue
            if inbox.ended:
                await asyncio.wait((reading,))
                if (error := reading.exception()) is not None:
                    raise error
            if (question := inbox.take_question()) is not None:
                version = await threads.answer(lambda: _accept(service, question))
                yield pb.StreamQueryResponse(question=question.number, accepted=pb.Accepted(version=version))
                continue
            pose, dropped = inbox.take_pose()
            if dropped is not None:
                yield pb.StreamQueryResponse(dropped=dropped)
            if pose is not None:
                async with aclosing(_answers(service, threads, pose)) as messages:
                    async for message in messages:
                        yield message
            elif inbox.ended:
                return
    finally:
        reading.cancel()
        with suppress(asyncio.CancelledError, Exception):
            await reading


def _heartbeat(question: int) -> pb.StreamQueryResponse:
    now = timestamp_pb2.Timestamp()
    now.GetCurrentTime()
    return pb.StreamQueryResponse(question=question, heartbeat=pb.Heartbeat(time=now))


class _Inbox:
    """Received messages that are not answered yet."""

    def __init__(self, heartbeat_s: float) -> None:
        self._default_heartbeat_s = heartbeat_s
        self._arrived = asyncio.Event()
        self.ended = False
        self._question: _Question | None = None
        self._next_question: _Question | None = None
        self._pose: _Pose | None = None
        self._dropped: pb.DroppedPoses | None = None
        self._last = -math.inf

    @property
    def number(self) -> int:
        return self._question.number if self._question is not None else 0

    @property
    def scene_id(self) -> str:
        return self._question.query.scene_id if self._question is not None else ""

    async def read(self, requests: AsyncIterator[pb.StreamQueryRequest]) -> None:
        """Reads requests as they arrive; a newer pose or question replaces an unanswered one."""
        try:
            async for request in requests:
                part = request.WhichOneof("part")
                if part == "question":
                    self._take_in_question(request.question)
                elif part == "pose":
                    self._take_in_pose(request.pose)
                else:
                    raise InvalidInputError(
                        "a message without content", field="part", hint="Send a question or a pose."
                    )
                self._arrived.set()
        finally:
            self.ended = True
            self._arrived.set()

    async def wait(self) -> bool:
        """Waits for a message or the stream's end; False after one heartbeat interval without any."""
        beat = self._question.heartbeat_s if self._question is not None else self._default_heartbeat_s
        if self._question is None:
            await self._arrived.wait()
            return True
        try:
            async with asyncio.timeout(beat):
                await self._arrived.wait()
        except TimeoutError:
            return False
        return True

    def take_question(self) -> _Question | None:
        question, self._next_question = self._next_question, None
        return question

    def take_pose(self) -> tuple[_Pose | None, pb.DroppedPoses | None]:
        """Returns the newest pose and the range of poses that it replaced."""
        pose, self._pose = self._pose, None
        dropped, self._dropped = self._dropped, None
        if not self.ended:
            self._arrived.clear()
        return pose, dropped

    def _take_in_question(self, question: pb.Subscription) -> None:
        query = from_proto(QueryRequest, question.query)
        if not query.scene_id or query.cameras or query.views:
            raise InvalidInputError(
                "a subscription is for one scene, and its cameras come as poses",
                field="question.query",
                hint="Name the scene, and leave cameras and views empty.",
            )
        beat = question.heartbeat_s or self._default_heartbeat_s
        if not _SHORTEST_HEARTBEAT_S <= beat <= _LONGEST_HEARTBEAT_S:
            raise InvalidInputError(
                f"a heartbeat of {beat} s",
                field="question.heartbeat_s",
                limit=f"{_SHORTEST_HEARTBEAT_S:g} to {_LONGEST_HEARTBEAT_S:g} s",
            )
        self._question = self._next_question = _Question(self.number + 1, query, beat)

    def _take_in_pose(self, pose: pb.StreamPose) -> None:
        if self._question is None:
            raise InvalidInputError("a pose before any question", field="question", hint="Send the question first.")
        if pose.sequence <= self._last:
            raise InvalidInputError(
                f"sequence number {pose.sequence} after {self._last}", field="pose.sequence", hint="Count upwards."
            )
        self._last = pose.sequence
        camera = from_proto(PosedCamera, pose.camera, "pose.camera")
        if self._pose is not None:
            older = self._pose.sequence
            if self._dropped is None:
                self._dropped = pb.DroppedPoses(first=older)
            self._dropped.last = older
            self._dropped.count += 1
        self._pose = _Pose(pose.sequence, camera, pose.stamp if pose.HasField("stamp") else None, self._question)


def _accept(service: SceneService, question: _Question) -> str:
    """Validates a question by asking it without outputs; returns the scene's version."""
    query = replace(question.query, outputs=frozenset(), max_matches=1)
    answers = service.answers.query(query, question.ranking).answers
    return answers[0].version


async def _answers(service: SceneService, threads: Threads, pose: _Pose) -> AsyncGenerator[pb.StreamQueryResponse]:
    query = replace(pose.question.query, cameras=(pose.camera,))
    if query.asker is None and query.asker_view is None:
        query = replace(query, asker=pose_of(pose.camera.world_from_camera))
    started = time.perf_counter()

    def messages() -> list[pb.QueryResponse]:
        try:
            answers = service.answers.query(query, pose.question.ranking).answers
            return [message for answer in answers for message in messages_of(answer)]
        except InvalidInputError as error:
            error.field = error.field.replace("cameras[0]", "pose.camera")
            raise

    work = asyncio.ensure_future(threads.answer(messages, background="mask2d" in query.outputs))
    try:
        while not work.done():
            await asyncio.wait((work,), timeout=pose.question.heartbeat_s)
            if not work.done():
                yield _heartbeat(pose.question.number)
    finally:
        work.cancel()
    seconds = time.perf_counter() - started
    head: dict[str, Any] = {"sequence": pose.sequence, "question": pose.question.number, "stamp": pose.stamp}
    for message in work.result():
        yield pb.StreamQueryResponse(**head, response=message)
    yield pb.StreamQueryResponse(**head, done=pb.PoseDone(seconds=seconds))
