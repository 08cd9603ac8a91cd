"""Scenes that are made anew without some of their photos: nothing of before stays, and a crash loses no withdrawal."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from sqlalchemy import Engine, select

from fastsplat.service.store.claims import Claim, execute_fenced, fenced, uncancelled
from fastsplat.service.store.damaged_rows import each_readable
from fastsplat.service.store.database import scrub, transaction
from fastsplat.service.store.made_scenes import publish_made_within
from fastsplat.service.store.photo_repository import read_verdicts, record_photos
from fastsplat.service.store.records import RESULT, OperationRecord, SceneSummary
from fastsplat.service.store.scene_repository import as_operation
from fastsplat.service.store.schema import operations, scene_photos
from fastsplat.service.store.version_repository import NewVersion


class Withdrawals:
    """Jobs that withdraw photos; every method raises `DatabaseError` when the database is away."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._writing = partial(transaction, engine)
        self._reading = partial(transaction, engine.execution_options(read_only=True))

    def unfinished_jobs(self, scene_id: str) -> Sequence[OperationRecord]:
        """Operations on a scene that wait or run."""
        here = select(operations).where(
            operations.c.scene_id == scene_id, operations.c.state.in_(("QUEUED", "RUNNING"))
        )
        with self._reading() as connection:
            return each_readable(connection.execute(here).mappings().all(), as_operation)

    def replace(
        self,
        claim: Claim,
        summary: SceneSummary,
        carried: Sequence[NewVersion],
        *,
        edited: str,
        result: Mapping[str, Any],
    ) -> Claim:
        """Put a scene in the place of all versions of before, and forget the verdicts of its withdrawn photos; the
        operation goes on.

        Args:
            claim: of which job.
            summary, carried, edited: see `publish_made_within`.
            result: of the operation, as JSON, with the names of the `photos`; whether it is there says whether this was
                done.

        Returns:
            The claim with the result.

        Raises:
            FencedError: the claim is not the newest any more, or the operation is to be cancelled.
            ConflictError: the scene was edited meanwhile.
            NotFoundError: it was deleted.
        """
        operation = claim.operation
        options = {**operation.options, RESULT: dict(result)}
        with self._writing() as connection:
            execute_fenced(connection, claim, uncancelled(claim).values(options=options, updated_at=time.time()))
            publish_made_within(connection, operation.scene_id, summary, carried, edited=edited, draft=False)
            here = select(scene_photos).where(scene_photos.c.scene_id == operation.scene_id)
            row = connection.execute(here).mappings().first()
            if row is not None:
                record_photos(connection, operation.scene_id, _without(read_verdicts(row), result["photos"]))
        return replace(claim, operation=replace(operation, options=options))

    def succeed(self, claim: Claim) -> None:
        """End an operation whose scene was replaced, and of whose photos no file is left; also what the database wrote
        of them is overwritten. To cancel it is too late.

        Raises:
            FencedError: the claim is not the newest any more.
        """
        scrub(self._engine)
        with self._writing() as connection:
            execute_fenced(connection, claim, fenced(claim).values(state="SUCCEEDED", updated_at=time.time()))


def _without(verdicts: Sequence[Mapping[str, Any]], photos: Collection[str]) -> list[Mapping[str, Any]]:
    """The verdicts of the other photos, which name none of these."""
    kept = []
    for verdict in verdicts:
        if verdict["name"] in photos:
            continue
        if verdict.get("duplicate_of") in photos:
            defects = [defect for defect in verdict.get("defects", ()) if defect != "duplicate"]
            verdict = {**verdict, "duplicate_of": "", "defects": defects, "advice": ""}
        if set(verdict.get("between", ())) & set(photos):
            verdict = {**verdict, "between": [], "advice": ""}
        kept.append(verdict)
    return kept
