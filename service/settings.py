"""The one settings object. Environment: FASTSPLAT_MODELS, FASTSPLAT_CAPTURE__MAX_IMAGES, and so on."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict, SettingsError

from fastsplat.service.calls.settings import CallSettings
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.common.errors import InvalidInputError
from fastsplat.service.common.settings import ENV_DELIMITER, ENV_PREFIX, SettingGroup, settings_error
from fastsplat.service.limits import LimitSettings, QuotaSettings
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.query.settings import QuerySettings
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.store.settings import ArtefactSettings


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
