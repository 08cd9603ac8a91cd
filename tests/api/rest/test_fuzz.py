"""Requests made up from the committed contract: none of them makes the server fail, and answers are what it says."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from schemathesis import Case
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from fastsplat.api.rest import openapi
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from tests.api.made_scene import add_scene
from tests.api.served import Faces


@schemathesis.serializer("application/offset+octet-stream")
def _as_it_is(context: Any, value: Any) -> Any:
    return value


_CHECKS = [not_a_server_error, status_code_conformance, content_type_conformance, response_schema_conformance]
_EXAMPLES = 10
_SCHEMA = schemathesis.openapi.from_dict(json.loads(openapi.COMMITTED.read_text()))
_OPERATIONS = {operation.ok().label: operation.ok() for operation in _SCHEMA.get_all_operations()}


@pytest.fixture(scope="module")
def victim(service: SceneService, api_settings: Settings) -> Iterator[dict[str, str]]:
    """A scene that may be asked and edited at will."""
    scene_id = add_scene(service, api_settings, "fuzzed")
    yield {"scene_id": scene_id, "operation_id": service.get_scene(scene_id).operation_id}
    service.delete_scene(scene_id)


@pytest.mark.parametrize("label", _OPERATIONS)
def test_no_request_makes_the_server_fail(faces: Faces, victim: dict[str, str], label: str) -> None:
    operation = _OPERATIONS[label]

    @settings(
        max_examples=_EXAMPLES,
        derandomize=True,
        database=None,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(), real=st.booleans())
    def ask(case: Case[Any], real: bool) -> None:
        if real and not label.startswith("DELETE"):
            case.path_parameters = {name: victim.get(name, value) for name, value in case.path_parameters.items()}
        response = case.call(base_url=str(faces.rest.base_url), timeout=120)  # a busy machine is no failure
        case.validate_response(response, checks=_CHECKS)

    ask()
