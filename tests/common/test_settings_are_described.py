"""Settings say what they are, where a reference page can read it."""

from __future__ import annotations

import pytest
from pydantic import BaseModel

from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.query.settings import QuerySettings


@pytest.mark.parametrize("settings", [QuerySettings, PerceptionSettings])
def test_every_setting_is_described(settings: type[BaseModel]) -> None:
    undescribed = [name for name, field in settings.model_fields.items() if not field.description]
    assert not undescribed
