"""The one settings object. Environment: FASTSPLAT_MODELS, FASTSPLAT_CAPTURE__MAX_IMAGES, and so on."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from service.capture.settings import CaptureSettings
from service.perception.settings import PerceptionSettings
from service.query.settings import QuerySettings
from service.splatting.settings import TrainingSettings


class Settings(BaseSettings):
    """Everything an operator can set, with the defaults of a laptop without a GPU."""

    model_config = SettingsConfigDict(env_prefix="FASTSPLAT_", env_nested_delimiter="__", frozen=True, extra="ignore")

    data_dir: Path = Field(Path("fastsplat-data"), description="scenes, uploads and the embedded database")
    models: Path = Field(Path(".models"), description="model directory, one folder a model")
    database_url: str = Field("", description="SQLAlchemy URL; empty: SQLite inside data_dir")
    host: str = "127.0.0.1"
    http_port: int = 8000
    grpc_port: int = 8001

    capture: CaptureSettings = CaptureSettings()
    perception: PerceptionSettings = PerceptionSettings()
    training: TrainingSettings = TrainingSettings()
    query: QuerySettings = QuerySettings()


@cache
def load_settings() -> Settings:
    """The settings of this process, read from the environment once."""
    return Settings()
