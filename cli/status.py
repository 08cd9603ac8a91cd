"""`fastsplat status`: what a server can do, and how much room a project has left."""

from __future__ import annotations

from fastsplat.cli.session import Session
from fastsplat.cli.tables import facts, minute, size
from fastsplat_contract.server_status import ModelStatus, QuotaStatus, ServerStatus


def status(session: Session) -> None:
    """Show what the server can do: models, workers, limits, and the project's quotas."""
    told = session.client.server_status()
    session.tell(told, _facts(told))


def _facts(told: ServerStatus) -> str:
    return facts(
        (
            ("release", told.version),
            ("project", f"{told.project}, as {told.role}"),
            ("key", "" if told.key_expires_at is None else f"expires {minute(told.key_expires_at)}"),
            (
                "workers",
                f"{told.workers}, which train with {told.training_backend}" if told.workers else "none: jobs wait",
            ),
            ("answers", f"are drawn with {told.backend}"),
            *((model.role.replace("_", " "), _model(model)) for model in told.models),
            *((quota.kind, _quota(quota)) for quota in told.quotas),
            ("upload", f"at most {size(told.max_upload_bytes)} and {told.max_images} images"),
            ("page", " ".join(told.addresses)),
        )
    )


def _model(model: ModelStatus) -> str:
    if model.state == "unset":
        return "none"
    uncalibrated = ", not calibrated" if model.calibrated is False else ""
    return f"{model.name}: {model.state}{uncalibrated}"


def _quota(quota: QuotaStatus) -> str:
    shown = size if quota.kind == "bytes" else "{:,.0f}".format
    return shown(quota.used) + ("" if quota.limit is None else f" of {shown(quota.limit)}")
