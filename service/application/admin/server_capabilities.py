"""Capabilities and health of this server, as visible to a caller."""

from __future__ import annotations

import ipaddress
import shutil
import socket
import time
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import get_args

from fastsplat.service.application.admin.project_keys import as_key
from fastsplat.service.query.language.meaning.calibration import calibration_for, calibration_key
from fastsplat.service.query.language.meaning.meaning import model_for, weighs_meanings
from fastsplat.service.settings import Settings
from fastsplat.service.store.blobs.reserve import floor_of
from fastsplat.service.store.store import Store
from fastsplat_contract.call import APART
from fastsplat_contract.errors import FastSplatError
from fastsplat_contract.jobs.name_suggestions import CaptionerStatus
from fastsplat_contract.server.keys import Role
from fastsplat_contract.server.server_status import (
    DiskHealth,
    ModelRole,
    ModelStatus,
    QueueHealth,
    QuotaStatus,
    ServerHealth,
    ServerStatus,
    WorkerHealth,
)

_SOMEWHERE = ("192.0.2.1", 9)
"""Documentation address (RFC 5737); nothing is sent to it."""


def server_status(store: Store, settings: Settings, project: str, role: Role, key_id: str) -> ServerStatus:
    """Status of the server, limited to what the caller's role may see.

    Args:
        store: of all projects.
        key_id: the caller's; "" without keys.
    """
    now = time.time()
    record = store.keys.find(key_id) if key_id else None
    key = None if record is None else as_key(record, now)
    usage, quotas = store.quota_usage.of(project), settings.quotas
    return ServerStatus(
        version=version("fastsplat"),
        project=project,
        role=role,
        key_expires_at=None if key is None else key.expires_at,
        asks_for_keys=settings.auth != "off",
        upload_operation="" if key is None else key.operation_id,
        models=() if role in APART else _models(settings),
        backend=settings.query.backend,
        training_backend=settings.training.backend,
        workers=store.workers.alive(settings.jobs.stalled_worker_timeout_s),
        quotas=()
        if role in APART
        else (
            QuotaStatus("scenes", usage.scenes, quotas.scenes or None),
            QuotaStatus("bytes", usage.stored_bytes, quotas.stored_bytes or None),
            QuotaStatus("jobs", usage.queued_jobs, quotas.queued_jobs or None),
        ),
        max_upload_bytes=settings.capture.max_upload_bytes,
        max_images=settings.capture.max_images,
        captioner=None if role in (*APART, "reader") else captioner_status(store, settings, project),
        addresses=() if role in (*APART, "reader") else page_addresses(settings),
        health=_health(store, settings) if role == "operator" else None,
    )


def _health(store: Store, settings: Settings) -> ServerHealth:
    """Health of workers, queue and disk; seconds include clock differences between machines."""
    now, timeout_s = time.time(), settings.jobs.stalled_worker_timeout_s
    registered = [worker for worker in store.workers.list_workers() if worker.heartbeat_at > 0]
    jobs, since = store.jobs.jobs_by_state(), store.jobs.waits_since()
    root = store.blobs.root
    disk = shutil.disk_usage(root)
    return ServerHealth(
        workers=tuple(
            WorkerHealth(
                host=worker.host,
                pid=worker.pid,
                silent_s=max(0.0, now - worker.heartbeat_at),
                alive=worker.heartbeat_at >= now - timeout_s,
            )
            for worker in sorted(registered, key=lambda worker: (worker.host, worker.pid))
        ),
        queue=QueueHealth(jobs["QUEUED"], jobs["RUNNING"], None if since is None else max(0.0, now - since)),
        disk=DiskHealth(disk.total, disk.free, floor_of(root, settings.uploads.min_free_bytes)),
    )


def page_addresses(settings: Settings) -> tuple[str, ...]:
    """URLs of the page for other machines, configured or by this machine's network address.

    Empty if the server listens only on loopback or on a port chosen by the system, or has no network.
    """
    if settings.page_address:
        return (settings.page_address.rstrip("/") + "/",)
    if not settings.http_port:
        return ()
    try:
        host = ipaddress.ip_address(settings.host.strip("[]"))
    except ValueError:  # a host name
        if settings.host.lower() == "localhost":
            return ()
        return (_url(settings, settings.host),)
    if host.is_unspecified:
        address = _own_address()
        return (_url(settings, address),) if address else ()
    return () if host.is_loopback else (_url(settings, f"[{host}]" if host.version == 6 else str(host)),)


def _url(settings: Settings, host: str) -> str:
    scheme = "http" if settings.tls_cert is None else "https"
    return f"{scheme}://{host}:{settings.http_port}{settings.root_path}/"


def _own_address() -> str:
    """This machine's address for outgoing connections; "" without a network."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(_SOMEWHERE)
            address = str(probe.getsockname()[0])
    except OSError:
        return ""
    return "" if ipaddress.ip_address(address).is_loopback else address


def _models(settings: Settings) -> tuple[ModelStatus, ...]:
    perception = settings.perception
    return tuple(_model(role, getattr(perception, role), settings) for role in get_args(ModelRole))


def _model(role: ModelRole, name: str, settings: Settings) -> ModelStatus:
    from fastsplat.service.perception.models.model_manifest import has_files  # as in `Admin`

    if not name:
        return ModelStatus(role, "", "unset", None)
    ready, calibrated = has_files(name, role, settings.models), None
    if role == "text_encoder" and ready:
        query, digest = settings.query, _digest(name, settings.models)
        if digest is not None:
            found = calibration_for(name, digest, query.score, query.templates, query.negatives)
            calibrated = found is not None
    if role == "lexicon" and ready:
        calibrated = weighed_with_encoder(settings)
    if role in ("image_text", "open_set_detector") and ready:
        calibrated = _is_measured(name, role, settings.models)
    return ModelStatus(role, name, "ready" if ready else "missing", calibrated)


def _is_measured(name: str, role: ModelRole, models: Path) -> bool | None:
    """True if a model's stored calibration was not refused; None if it is damaged. The model is not opened."""
    from fastsplat.service.instances.naming.name_models import STORED, NameModel  # as in `Admin`
    from fastsplat.service.perception.models.model_manifest import find_model
    from fastsplat.service.query.phrases.object_looks import Calibration

    kind = Calibration if role == "image_text" else NameModel
    try:
        return kind.model_validate_json((models / find_model(name, role)[1] / STORED).read_text("utf-8")).measured
    except FileNotFoundError:
        return False
    except (ValueError, OSError):
        return None


def weighed_with_encoder(settings: Settings) -> bool:
    """True if answers use the lexicon: measured with this encoder, without cosine threshold."""
    query, perception = settings.query, settings.perception
    digest = _digest(perception.text_encoder, settings.models)
    return (
        digest is not None
        and weighs_meanings(query)
        and model_for(calibration_key(perception.text_encoder, digest), perception.lexicon, query.templates) is not None
    )


def _digest(name: str, models: Path) -> str | None:
    """Hash of an encoder's weights; None if it cannot be opened now."""
    try:
        return _opened_digest(name, models)
    except FastSplatError:
        return None


@cache
def _opened_digest(name: str, models: Path) -> str:
    from fastsplat.service.perception.text.text_encoders import open_text_encoder

    return open_text_encoder(name, models).sha256


def captioner_status(store: Store, settings: Settings, project: str) -> CaptionerStatus | None:
    """Configured captioner, and the project's consent to its host; None without a captioner."""
    captioner = settings.captioner
    if not captioner.url:
        return None
    return CaptionerStatus(captioner.host, captioner.model, store.projects.agreed(project) == captioner.host)
