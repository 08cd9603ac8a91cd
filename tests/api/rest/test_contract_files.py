"""What is committed of the contract is what the sources say, and its sizes hold."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fastsplat.api.grpc.upload import MAX_MESSAGE_BYTES
from fastsplat.api.rest import openapi
from fastsplat.service.application.jobs.stored import scene_of
from fastsplat.service.application.service import MAX_LISTED
from fastsplat.service.store.rows.codec import camera_to_json
from fastsplat.service.store.rows.records import SceneRecord
from fastsplat_contract.calls import CALLS
from fastsplat_contract.codec.proto_codec import to_proto
from fastsplat_contract.v1 import fastsplat_pb2
from protos import generate
from protos.proto_text import proto_text
from protos.registry import Registry
from tests.api.made_scene import turned


def test_the_proto_is_that_of_the_types() -> None:
    registry = Registry(generate.NUMBERS)
    written = proto_text(generate.PROTO.with_suffix(".proto.in").read_text(), registry)
    assert written == generate.PROTO.read_text(), "fastsplat.proto is stale: make protos"


def test_the_generated_code_is_that_of_the_proto(tmp_path: Path) -> None:
    generate.generate(tmp_path)
    assert {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.py*")} == set(generate.GENERATED)
    for name in generate.GENERATED:
        assert (tmp_path / name).read_text() == (generate.OUTPUT / name).read_text(), f"{name} is stale: make protos"


@pytest.fixture(scope="module")
def described() -> dict[str, Any]:
    """What the routes say of themselves."""
    return openapi.describe()


def test_the_openapi_file_is_that_of_the_routes(described: dict[str, Any]) -> None:
    committed = json.loads(openapi.COMMITTED.read_text())
    assert committed == described, "openapi.json is stale: python -m fastsplat.api.rest.openapi"


def test_every_operation_documents_its_problems(described: dict[str, Any]) -> None:
    assert "Problem" in described["components"]["schemas"]
    for path, methods in described["paths"].items():
        for operation in methods.values():
            assert path == "/livez" or "application/problem+json" in operation["responses"]["4XX"]["content"]
            assert "422" not in operation["responses"]
            assert operation["description"]


def test_every_rest_call_has_its_rpc_and_only_subscriptions_are_grpc_alone(described: dict[str, Any]) -> None:
    """Health is grpc.health.v1; a resumable upload is CreateScene's stream; who has found gRPC need not ask for it."""
    routes = {f"{method.upper()} {path}" for path, methods in described["paths"].items() for method in methods}
    elsewhere = {"GET /livez", "GET /readyz", "GET /v1/server"} | {route for route in routes if "/v1/uploads" in route}
    assert {route for call in CALLS for route in call.routes} == routes - elsewhere
    rpcs = {method.name for method in fastsplat_pb2.DESCRIPTOR.services_by_name["SceneService"].methods}
    assert rpcs - {call.rpc for call in CALLS if call.routes} == {"StreamQuery"}


def test_what_goes_with_the_next_release_is_said_to_everybody(described: dict[str, Any]) -> None:
    rpcs = fastsplat_pb2.DESCRIPTOR.services_by_name["SceneService"].methods_by_name
    page = (Path(__file__).parents[3] / "docs" / "operating.md").read_text()
    names = {call.rpc for call in CALLS if not call.deprecated}
    for call in CALLS:
        assert rpcs[call.rpc].GetOptions().deprecated == bool(call.deprecated)
        for route in call.routes:
            method, path = route.split(" ")
            operation = described["paths"][path][method.lower()]
            assert operation.get("deprecated", False) == bool(call.deprecated)
            assert (f"Deprecated: use {call.deprecated}." in operation["description"]) == bool(call.deprecated)
        assert (f"| `{call.rpc}` | `{call.route}` | {call.deprecated} |" in page) == bool(call.deprecated)
        assert not call.deprecated or re.split(r"\W", call.deprecated)[0] in names


def test_a_scene_of_very_many_labels_and_views_fits_in_a_message() -> None:
    most = MAX_LISTED
    label = {"label": "x" * 200, "aliases": [], "pixels": 10**9, "views": 10**6, "gaussian_count": 10**9}
    record = SceneRecord(
        id="s",
        name="n" * 200,
        operation_id="o",
        state="READY",
        version="1",
        created_at=0.0,
        gaussians=10**9,
        scale="METRIC",
        dictionary=[{**label, "label_id": n} for n in range(1, 60_001)],
        cameras=[camera_to_json(replace(turned(0.1), name="x" * 100))] * 20_000,
        quality={},
    )
    scene = scene_of(record, most)
    assert (scene.label_count, scene.camera_count) == (60_000, 20_000)
    assert len(scene.dictionary) == len(scene.cameras) == most
    assert to_proto(scene).ByteSize() < MAX_MESSAGE_BYTES
