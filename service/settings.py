"""The one settings object. Environment: FASTSPLAT_MODELS, FASTSPLAT_CAPTURE__MAX_IMAGES, and so on."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict, SettingsError

from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.common.settings import ENV_DELIMITER, ENV_PREFIX, SettingGroup, settings_error
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.query.settings import QuerySettings
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.store.settings import ArtefactSettings
from fastsplat_contract.errors import InvalidInputError


class JobSettings(SettingGroup, section="jobs"):
    """How workers take and watch jobs, and when they give up."""

    max_starts: int = Field(3, ge=1)
    """A job is FAILED once its trainer or worker has died this often."""

    poll_interval_s: float = Field(0.3, gt=0)
    """How often a worker looks for new jobs and for cancellations."""

    progress_interval_s: float = Field(0.5, gt=0)
    """A running stage's progress is written at most this often."""

    heartbeat_interval_s: float = Field(2.0, gt=0)
    """How often a worker writes its heartbeat."""

    stalled_worker_timeout_s: float = Field(10.0, gt=0)
    """A worker without a heartbeat for this long is taken for dead; its jobs go to others."""

    cleanup_interval_s: float = Field(60.0, gt=0)
    """How often a worker removes folders, uploads, logs and rows that are not needed any more."""

    ended_job_retention_s: float = Field(30 * 24 * 3600.0, gt=0)
    """Logs and rows of ended jobs without a scene are removed after this."""

    threads_per_job: int = Field(0, ge=0)
    """CPU threads of a trainer; 0: all of the machine's."""


class UploadSettings(SettingGroup, section="uploads"):
    """How long uploads are stored."""

    expiry_s: float = Field(24 * 3600.0, gt=0)
    """An upload that was not committed is removed after this; so is a resumable one, counted from its last piece."""


class StoreSettings(BaseModel):
    """Limits of the service layer that belong to no other room."""

    model_config = ConfigDict(frozen=True)

    max_name_chars: int = 200
    max_labels: int = 1_000
    max_label_chars: int = 200
    max_time_budget_s: float = 24 * 3600.0
    max_gaussians: int = 20_000_000
    max_page_size: int = 500


class LimitSettings(BaseModel):
    """Requests at a time and over time. What passes them is refused at once, with the time to wait."""

    model_config = ConfigDict(frozen=True)

    rate_per_s: float = Field(1_000.0, gt=0, description="requests a second of one key, over time")
    burst: int = Field(2_000, ge=1, description="requests of one key at once after a pause")
    in_flight: int = Field(64, ge=1, description="requests of one key under way, standing ones included")
    uploads: int = Field(4, ge=1, description="uploads of one key under way; all keys share eight threads for them")
    admitted: int = Field(96, ge=1, description="requests of all keys that compute or wait for a thread")
    threads: int = Field(0, ge=0, description="threads that answer requests; 0: two a core, at least four")


class QuotaSettings(BaseModel):
    """What one key may hold. 0: no bound."""

    model_config = ConfigDict(frozen=True)

    scenes: int = Field(0, ge=0, description="scenes")
    stored_bytes: int = Field(0, ge=0, description="bytes of uploads whose scenes exist, and of unfinished uploads")
    queued_jobs: int = Field(0, ge=0, description="jobs that are queued or run")


class CallSettings(BaseModel):
    """What an answer may hold, and how much is kept in memory between answers."""

    model_config = ConfigDict(frozen=True)

    scene_memory_bytes: int = Field(
        4 << 30, ge=1, description="open scenes are kept up to this, least recently used leave first"
    )
    max_matches: int = Field(100, ge=1, description="entries an answer ranks where the request does not say how many")
    max_listed: int = Field(5_000, ge=1, description="labels and cameras of a scene that are told in one piece")
    max_versions: int = Field(50, ge=2, description="versions of one scene")
    max_edits: int = Field(100, ge=1, description="edits in one request")
    heartbeat_s: float = Field(5.0, gt=0, description="a standing question says that it lives after so long a silence")


class Settings(BaseSettings):
    """Everything an operator can set, with the defaults of a laptop without a GPU."""

    model_config = SettingsConfigDict(
        env_prefix=ENV_PREFIX, env_nested_delimiter=ENV_DELIMITER, frozen=True, extra="ignore"
    )

    data_dir: Path = Field(Path("fastsplat-data"), description="scenes, uploads and the embedded database")
    models: Path = Field(Path(".models"), description="model directory, one folder a model")
    database_url: str = Field("", description="SQLAlchemy URL; empty: SQLite inside data_dir")
    host: str = "127.0.0.1"
    http_port: int = 8000
    grpc_port: int = 8001
    grpc_address: str = Field(
        "",
        pattern=r"^$|^([^\s:\[\]]*|\[[0-9A-Fa-f:.]+\]):\d{1,5}$",
        description="what clients are told of gRPC: host:port, or :port at the host they know; empty: grpc_port",
    )
    metrics_host: str = "127.0.0.1"
    metrics_port: int = Field(8002, description="Prometheus metrics; they need no key")

    auth: Literal["on", "off"] = Field("on", description='"off": no keys; the server then binds to loopback alone')
    tls_cert: Path | None = Field(None, description="PEM certificate chain of both ports; needs tls_key")
    tls_key: Path | None = Field(None, description="PEM private key of both ports; needs tls_cert")
    tls_client_ca: Path | None = Field(None, description="PEM certificates; clients must show one that they signed")
    drain_notice_s: float = Field(0.0, ge=0, description="on SIGTERM: not ready, but answering, for so long")
    drain_s: float = Field(10.0, ge=0, description="on SIGTERM, after that: running requests may take so long")

    capture: CaptureSettings = CaptureSettings()
    perception: PerceptionSettings = PerceptionSettings()
    training: TrainingSettings = TrainingSettings()
    discovery: DiscoverySettings = DiscoverySettings()
    query: QuerySettings = QuerySettings()
    jobs: JobSettings = JobSettings()
    uploads: UploadSettings = UploadSettings()
    store: StoreSettings = StoreSettings()
    artefacts: ArtefactSettings = ArtefactSettings()
    calls: CallSettings = CallSettings()
    limits: LimitSettings = LimitSettings()
    quotas: QuotaSettings = QuotaSettings()

    @property
    def first_key(self) -> Path:
        """Where the key lies that the first start makes."""
        return self.data_dir / "key"


@cache
def load_settings() -> Settings:
    """The settings of this process, read from the environment once.

    Raises:
        InvalidInputError: a variable has a value that its setting cannot have, or names a setting that does not exist.
    """
    try:
        return Settings()
    except ValidationError as error:
        raise settings_error(error) from error
    except SettingsError as error:  # a group that is not JSON
        raise InvalidInputError(str(error), hint="Write a group as a JSON object, or its fields one by one.") from error
