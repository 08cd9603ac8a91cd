"""Quotas of projects, checked before bytes are taken and again in the transaction that makes a scene."""

from __future__ import annotations

from sqlalchemy import Connection

from fastsplat.service.settings import QuotaSettings
from fastsplat.service.store.repositories.quota_usage import QuotaUsage, Usage, reserve
from fastsplat_contract.errors import QuotaError


class Quotas:
    """Quotas of every project, all of them alike."""

    def __init__(self, usage: QuotaUsage, settings: QuotaSettings) -> None:
        self._usage = usage
        self._settings = settings

    def check_room(self, project: str, pending_bytes: int) -> None:
        """Return if `project` may make one scene more, beside `pending_bytes` of unfinished uploads.

        Raises:
            QuotaError: they may not; says which bound it is.
            DatabaseError: the database does not answer.
        """
        if not self.bounded:
            return
        usage = self._usage.of(project)
        self._check(Usage(usage.scenes + 1, usage.stored_bytes + pending_bytes, usage.queued_jobs + 1))

    def check_retry(self, project: str) -> None:
        """Return if `project` may have one job more that waits or runs. Raises `QuotaError`: it may not."""
        usage = self._usage.of(project)
        self._check(Usage(usage.scenes, usage.stored_bytes, usage.queued_jobs + 1))

    def reserve(self, connection: Connection, project: str, scene_id: str, size: int) -> None:
        """Count a scene against its project, in the transaction that makes it.

        Raises:
            QuotaError: it would pass a bound; the transaction must not be committed.
        """
        self._check(reserve(connection, project, scene_id, size))

    @property
    def bounded(self) -> bool:
        """Whether there is any bound."""
        return bool(self._settings.scenes or self._settings.stored_bytes or self._settings.queued_jobs)

    def _check(self, usage: Usage) -> None:
        bounds = (
            ("scenes", usage.scenes, self._settings.scenes, "Delete scenes that are not needed any more."),
            ("bytes", usage.stored_bytes, self._settings.stored_bytes, "Delete scenes or unfinished uploads."),
            ("jobs", usage.queued_jobs, self._settings.queued_jobs, "Wait until a job has ended, or cancel one."),
        )
        settings = ("SCENES", "STORED_BYTES", "QUEUED_JOBS")
        for (what, count, limit, hint), setting in zip(bounds, settings, strict=True):
            if limit and count > limit:
                raise QuotaError(
                    f"with this, the project would hold {count} {what}",
                    field=what,
                    limit=f"{limit} {what} of one project (FASTSPLAT_QUOTAS__{setting})",
                    hint=hint,
                )
