"""The one settings object. Environment: FASTSPLAT_MODELS, FASTSPLAT_CAPTURE__MAX_IMAGES, and so on."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

from platformdirs import user_data_path
from pydantic import Field, ValidationError, model_validator
from pydantic_settings import (
    BaseSettings,
    EnvSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    SettingsError,
)

from fastsplat.service.capture.capture_settings import CaptureSettings, PhotoSettings
from fastsplat.service.common.setting_groups import (
    ENV_DELIMITER,
    ENV_PREFIX,
    Options,
    SettingGroup,
    check_groups,
    check_variables,
    settings_error,
)
from fastsplat.service.instances.discovery_settings import DiscoverySettings, LookAgainOptions, PromptOptions
from fastsplat.service.localization.localization_settings import LocalizationSettings
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.splat_import.splat_import_settings import SplatImportSettings
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.store.artefact_settings import ArtefactSettings
from fastsplat_contract.errors import InvalidInputError

_FILE = "_file"


class JobOptions(Options):
    """How often a job writes what it does. Tests let it write faster."""

    progress_interval_s: float = Field(0.5, gt=0)
    """A running stage's progress is written at most this often."""


class JobSettings(JobOptions, SettingGroup, section="jobs"):
    """How workers take and watch jobs, and when they give up."""

    launcher: Literal["local", "ray"] = "local"
    """Where jobs run: in the worker itself, one by one, or on the nodes of a Ray cluster, as many as have room."""
    max_starts: int = Field(3, ge=1)
    """A job is FAILED once its trainer or worker has died this often without coming further in between."""
    poll_interval_s: float = Field(2.0, gt=0)
    """How often a worker looks for new jobs and for cancellations."""
    stalled_worker_timeout_s: float = Field(10.0, gt=0)
    """A worker without a heartbeat for this long is taken for dead; its jobs go to others."""
    ended_job_retention_s: float = Field(30 * 24 * 3600.0, gt=0)
    """Logs and rows of ended jobs without a scene are removed after this."""
    threads_per_job: int = Field(0, ge=0)
    """CPU threads of a trainer; 0: all of the machine's."""
    niceness: int = Field(15, ge=0, le=19)
    """How nice a trainer is to other processes, requests to the API of the same machine among them, beyond the worker's
    own niceness; 0: not at all. A machine that does nothing else loses nothing by it."""

    @property
    def heartbeat_interval_s(self) -> float:
        """Seconds after which a worker writes its heartbeat again."""
        return self.stalled_worker_timeout_s / 5


class UploadOptions(Options):
    """When a slow sender is disconnected."""

    min_bytes_per_s: float = Field(1024.0, gt=0)
    """A sender that is slower than this over the whole upload is disconnected."""
    slow_start_s: float = Field(20.0, gt=0)
    """Seconds that a sender may be silent, or behind `min_bytes_per_s`."""


class UploadSettings(UploadOptions, SettingGroup, section="uploads"):
    """How long uploads are stored."""

    expiry_s: float = Field(24 * 3600.0, gt=0)
    """An upload that was not committed is removed after this; so is a resumable one, counted from its last piece."""
    failed_retention_s: float = Field(24 * 3600.0, ge=0)
    """The upload of a job that failed or was cancelled is kept for so long, for a retry; deleting its scene removes it
    at once."""
    min_free_bytes: int = Field(1 << 30, ge=0)
    """Uploads are refused, and broken off, while the data folder's disk has less free space than this, so that jobs
    that run can end and scenes can be deleted; 0: never."""
    deadline_s: float = Field(6 * 3600.0, gt=0)
    """Seconds that receiving one upload, or one piece of a resumable one, may take."""


class StoreOptions(Options):
    """Limits of the service layer that belong to no other room."""

    max_labels: int = 1_000
    """Labels that one scene may be asked for."""
    max_label_chars: int = 200
    """Characters of a label."""
    max_gaussians: int = 20_000_000
    """Gaussians that one scene may ask for."""
    max_page_size: int = 500
    """Entries of one page of a list."""


class LimitOptions(Options):
    """What one connection and one key may cost, and on which threads answers are computed."""

    connections: int = Field(8_192, ge=1)
    """HTTP connections, and as many gRPC calls under way."""
    head_s: float = Field(15.0, gt=0)
    """Seconds in which the head of an HTTP request must have come."""
    threads: int = Field(0, ge=0)
    """Threads that answer requests, round robin over keys, and as many for those that render; 0: two a core, at least
    four."""
    niceness: int = Field(10, ge=0, le=19)
    """How much nicer (Linux) those threads are than the others; 0: not at all."""


class LimitSettings(LimitOptions, SettingGroup, section="limits"):
    """Requests at a time and over time. What passes them is refused at once, with the time to wait."""

    rate_per_s: float = Field(1_000.0, gt=0)
    """Requests a second of one key, over time."""
    burst: int = Field(2_000, ge=1)
    """Requests of one key at once after a pause."""
    in_flight: int = Field(64, ge=1)
    """Requests of one key under way, standing ones included."""
    uploads: int = Field(4, ge=1)
    """Uploads of one key under way."""
    all_uploads: int = Field(1_024, ge=1)
    """Uploads of all keys under way; more are refused at once."""
    upload_memory_bytes: int = Field(2**31, ge=2**24)
    """Memory of uploads of all keys under way; one over gRPC counts 8 MiB, as its messages are held whole."""
    admitted: int = Field(96, ge=1)
    """Requests of all keys that compute or wait for a thread."""
    answer_s: float = Field(60.0, gt=0)
    """Seconds that one question or picture may take, waiting included."""


class QuotaSettings(SettingGroup, section="quotas"):
    """What one project may hold. 0: no bound."""

    scenes: int = Field(1_000, ge=0)
    """Scenes."""
    stored_bytes: int = Field(100 * 2**30, ge=0)
    """Bytes of uploads whose scenes exist, and of unfinished uploads."""
    queued_jobs: int = Field(100, ge=0)
    """Jobs that are queued or run."""


class CallOptions(Options):
    """What is kept of labels, and how an answer is cut and kept alive."""

    ranking_memory_bytes: int = Field(512 << 20, ge=1)
    """Labels and names of objects, by which scenes are asked all at once, are kept up to this; about 2 MB for 50
    labels; least recently used leave first."""
    max_matches: int = Field(100, ge=1)
    """Entries an answer ranks where the request does not say how many."""
    max_known_names: int = Field(1_000, ge=1)
    """Names that people gave whose looks a project remembers; the oldest leave."""
    heartbeat_s: float = Field(5.0, gt=0)
    """A subscription says that it lives after so long a silence."""


class CallSettings(CallOptions, SettingGroup, section="calls"):
    """What an answer may hold, and how much is kept in memory between answers."""

    scene_memory_bytes: int = Field(4 << 30, ge=1)
    """Open scenes are kept up to this, least recently used leave first."""
    answer_memory_bytes: int = Field(0, ge=0)
    """Bytes that answers under way may hold together beside open scenes, by estimate; more wait; 0: half of the
    machine's memory, or of its control group's limit."""
    request_memory_bytes: int = Field(0, ge=0)
    """Bytes that one answer may hold, by estimate; 0: a quarter of that memory."""
    max_queried_scenes: int = Field(100, ge=1)
    """Scenes, the newest, that a question to all of them asks."""
    max_versions: int = Field(20, ge=2)
    """Versions of one scene that are kept; an edit beyond removes undone ones, then the oldest."""


class CaptionerOptions(Options):
    """What asking the captioner may cost."""

    request_s: float = Field(60.0, gt=0)
    """Seconds for one answer."""
    total_s: float = Field(240.0, gt=0)
    """Seconds for all answers about one scene."""


class CaptionerSettings(CaptionerOptions, SettingGroup, section="captioner"):
    """A model that sees pictures and suggests names for new scenes of projects that agreed; none by default."""

    url: str = Field("", pattern=r"^$|^https?://[^\s/?#@]+(/[^\s?#]*)?$")
    """Of its OpenAI-compatible interface, e.g. http://localhost:11434/v1; empty: there is none, and nothing is sent."""
    model: str = Field("", max_length=200)
    """As the interface calls it; needed with url."""
    key: str = Field("", repr=False)
    """For an interface that wants one, best from a file."""

    @model_validator(mode="after")
    def _check_model(self) -> CaptionerSettings:
        if self.url and not self.model.strip():
            raise ValueError("a url needs a model")
        return self

    @property
    def host(self) -> str:
        """Where pictures would go: host, and port if it is given."""
        return urlsplit(self.url).netloc


class _EnvironmentAndFiles(EnvSettingsSource):
    """Environment variables, and the content of files that variables with the suffix _FILE name, as in
    FASTSPLAT_DATABASE_PASSWORD_FILE for FASTSPLAT_DATABASE_PASSWORD.

    Secrets come as files, which neither child processes nor `docker inspect` show.
    """

    def _load_env_vars(self) -> Mapping[str, str | None]:
        variables = dict(super()._load_env_vars())
        for name in [name for name in variables if name.startswith(ENV_PREFIX.lower()) and name.endswith(_FILE)]:
            path, setting = variables.pop(name), name.removesuffix(_FILE)
            if path and variables.get(setting):
                raise InvalidInputError(f"{setting.upper()} and {name.upper()} are both set", field=name.upper())
            if path:
                variables[setting] = _secret(name.upper(), Path(path))
        check_variables(variables, self.settings_cls)
        return variables

    def __call__(self) -> dict[str, Any]:
        values = super().__call__()
        check_groups(values, self.settings_cls)
        return values


def _secret(variable: str, path: Path) -> str:
    try:
        return path.read_text().rstrip("\r\n")
    except (OSError, ValueError) as error:
        raise InvalidInputError(
            f"the file that {variable} names cannot be read: {getattr(error, 'strerror', 'it is no text')}",
            field=variable,
            hint="Make it readable for the service's user.",
        ) from error


def find_models(data_dir: Path) -> Path:
    """The model directory where none is named: `models` in the data folder, or `.models` where the process was started,
    if there is one; otherwise the user's own, where the platform keeps such data, be it there or not."""
    near = (data_dir / "models", Path(".models"))
    return next((folder for folder in near if folder.is_dir()), user_data_path("fastsplat", appauthor=False) / "models")


class Settings(BaseSettings):
    """Everything an operator can set, with the defaults of a laptop without a GPU."""

    model_config = SettingsConfigDict(
        env_prefix=ENV_PREFIX,
        env_nested_delimiter=ENV_DELIMITER,
        frozen=True,
        extra="forbid",
        use_attribute_docstrings=True,
    )

    data_dir: Path = Path("fastsplat-data")
    """Scenes, uploads and the embedded database."""
    models: Path = Field(default_factory=lambda values: find_models(values["data_dir"]))
    """Model directory, one folder a model; left out: see find_models."""
    database_url: str = ""
    """SQLAlchemy URL; empty: SQLite inside data_dir."""
    database_password: str = Field("", repr=False)
    """For a database_url without one, best from a file."""
    host: str = "127.0.0.1"
    """Address that REST, gRPC and the page listen at."""
    http_port: int = 8000
    """Of REST and the page."""
    grpc_port: int = 8001
    """Of gRPC."""
    grpc_address: str = Field("", pattern=r"^$|^([^\s:\[\]]*|\[[0-9A-Fa-f:.]+\]):\d{1,5}$")
    """What clients are told of gRPC: host:port, or :port at the host they know; empty: grpc_port."""
    root_path: str = Field("", pattern=r"^$|^(/[\w.~-]+)+$")
    """Path under which a proxy shows the HTTP interface, cut off by it."""
    cors_origins: tuple[str, ...] = ()
    """Origins whose pages may call the HTTP interface from a browser; none: the server's own alone."""
    trusted_proxies: tuple[str, ...] = ()
    """Addresses of proxies whose X-Forwarded headers are believed; none: nobody's."""
    metrics_host: str = "127.0.0.1"
    """Address that the metrics listen at."""
    metrics_port: int = 8002
    """Prometheus metrics; they need no key."""
    page_address: str = ""
    """Where other machines reach the web page, for links to phones; empty: found by host and port."""
    auth: Literal["on", "off"] = "on"
    """Whether requests need a key; without, the server binds to loopback alone."""
    tls_cert: Path | None = None
    """PEM certificate chain of both ports; needs tls_key."""
    tls_key: Path | None = None
    """PEM private key of both ports; needs tls_cert."""
    tls_client_ca: Path | None = None
    """PEM certificates; clients must show one that they signed."""
    drain_notice_s: float = Field(0.0, ge=0)
    """On SIGTERM: not ready, but answering, for so long."""
    drain_s: float = Field(10.0, ge=0)
    """On SIGTERM, after that: running requests may take so long."""
    capture: CaptureSettings = CaptureSettings()
    perception: PerceptionSettings = PerceptionSettings()
    training: TrainingSettings = TrainingSettings()
    discovery: DiscoverySettings = DiscoverySettings()
    prompts: PromptOptions = PromptOptions()
    splat_import: SplatImportSettings = SplatImportSettings()
    look_again: LookAgainOptions = LookAgainOptions()
    query: QuerySettings = QuerySettings()
    jobs: JobSettings = JobSettings()
    photos: PhotoSettings = PhotoSettings()
    uploads: UploadSettings = UploadSettings()
    store: StoreOptions = StoreOptions()
    artefacts: ArtefactSettings = ArtefactSettings()
    calls: CallSettings = CallSettings()
    limits: LimitSettings = LimitSettings()
    quotas: QuotaSettings = QuotaSettings()
    captioner: CaptionerSettings = CaptionerSettings()
    localization: LocalizationSettings = LocalizationSettings()

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Values given in Python, then the environment and the files that it names."""
        return init_settings, _EnvironmentAndFiles(settings_cls)

    @model_validator(mode="before")
    @classmethod
    def _join_password(cls, values: Any) -> Any:
        """Put the password into the URL, which is what all who open the database are given."""
        if isinstance(values, dict) and values.get("database_url") and values.get("database_password"):
            from sqlalchemy import make_url  # nothing else here needs the database's library

            url = make_url(values["database_url"])
            if url.password is None:
                url = url.set(password=values["database_password"])
            values = {**values, "database_url": url.render_as_string(hide_password=False), "database_password": ""}
        return values

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
        raise settings_error(error, Settings) from error
    except SettingsError as error:  # a group that is not JSON
        raise InvalidInputError(str(error), hint="Write a group as a JSON object, or its fields one by one.") from error
