"""Project quotas, checked before upload and in the transaction that creates a scene."""

from __future__ import annotations

from sqlalchemy import Connection

from fastsplat.service.settings import QuotaSettings
from fastsplat.service.store.repositories.quota_usage import QuotaUsage, Usage, reserve
from fastsplat_contract.errors import QuotaError


class Quotas:
    """The same quotas for every project."""

    def __init__(self, usage: QuotaUsage, settings: QuotaSettings) -> None:
        self._usage = usage
        self._settings = settings

    def check_room(self, project: str, pending_bytes: int) -> None:
        """Raises `QuotaError` unless one more scene fits beside `pending_bytes` of unfinished uploads."""
        if not self.bounded:
            return
        usage = self._usage.of(project)
        self._check(Usage(usage.scenes + 1, usage.stored_bytes + pending_bytes, usage.queued_jobs + 1))

    def check_retry(self, project: str) -> None:
        """Raises `QuotaError` unless one more active job fits."""
        usage = self._usage.of(project)
        self._check(Usage(usage.scenes, usage.stored_bytes, usage.queued_jobs + 1))

    def reserve(self, connection: Connection, project: str, scene_id: str, size: int) -> None:
        """Counts a scene in the transaction that creates it, to be aborted on `QuotaError`."""
        self._check(reserve(connection, project, scene_id, size))

    @property
    def bounded(self) -> bool:
        """True if any quota is set."""
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
