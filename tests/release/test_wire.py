"""What released calls promise holds; a mended wire that takes something away is found."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fastsplat.api.rest import openapi
from release.wire import RELEASED, grpc_promises, grpc_today, read_release, rest_broken


@pytest.mark.parametrize("release", sorted(RELEASED.glob("*.zip")), ids=lambda path: path.stem)
def test_what_a_release_promised_holds(release: Path) -> None:
    rest, grpc = read_release(release)
    assert not rest_broken(rest, json.loads(openapi.COMMITTED.read_text()))
    assert not grpc_promises(grpc) - grpc_promises(grpc_today())


def _box(document: Any) -> Any:
    return document["components"]["schemas"]["Box"]


@pytest.mark.parametrize(
    ("breaks", "change"),
    [
        (True, lambda document: document["paths"].pop("/v1/scenes/{scene_id}")),
        (True, lambda document: _box(document)["properties"].pop("size")),
        (True, lambda document: _box(document)["properties"]["size"].update({"$ref": "#/components/schemas/Pose"})),
        (True, lambda document: _box(document)["required"].append("fill")),
        (
            True,
            lambda document: document["paths"]["/v1/estimate"]["get"]["parameters"][1]["schema"].update(type="string"),
        ),
        (False, lambda document: _box(document)["properties"].update(fill={"type": "number"})),
        (False, lambda document: _box(document).update(description="A box.")),
        (False, lambda document: document["paths"]["/v1/scenes"].pop("get")),  # deprecated before
    ],
)
def test_fields_and_paths_may_come_and_not_go_or_change(breaks: bool, change: Callable[[Any], object]) -> None:
    before, now = (json.loads(openapi.COMMITTED.read_text()) for _ in range(2))
    before["paths"]["/v1/scenes"]["get"]["deprecated"] = True
    change(now)
    assert bool(rest_broken(before, now)) == breaks


def test_a_number_a_type_and_a_call_of_grpc_stay() -> None:
    said, changed = grpc_promises(grpc_today()), grpc_today()
    changed.message_type[0].field[0].number = 4711
    changed.message_type[1].field[0].type += 1
    del changed.service[0].method[0]
    changed.message_type.add(name="New").field.add(name="more", number=1)
    assert len(said - grpc_promises(changed)) == 3
