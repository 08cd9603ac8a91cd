"""What is committed of the contract is what the sources say, and its sizes hold."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

from hypothesis import given, settings
from hypothesis import strategies as st

from api.grpc.messages import CHUNK_BYTES, messages_of
from api.grpc.server import MAX_MESSAGE_BYTES
from api.rest import openapi
from fastsplat_client.messages import joined
from service.calls.types import QueryAnswer, RleMask, ViewMask
from service.query.types import Answer, Match

_PROTOS = Path(__file__).resolve().parents[2] / "protos"


def _generator() -> ModuleType:
    spec = importlib.util.spec_from_file_location("generate", _PROTOS / "generate.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_generated_code_is_that_of_the_proto(tmp_path: Path) -> None:
    generator = _generator()
    generator.generate(tmp_path)
    assert {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.py*")} == set(generator.GENERATED)
    for name in generator.GENERATED:
        assert (tmp_path / name).read_text() == (_PROTOS / name).read_text(), f"{name} is stale: make protos"


def test_the_openapi_file_is_that_of_the_routes() -> None:
    committed = json.loads(openapi.COMMITTED.read_text())
    assert committed == openapi.describe(), "openapi.json is stale: python -m api.rest.openapi"


def test_every_operation_documents_its_problems() -> None:
    document = openapi.describe()
    assert "Problem" in document["components"]["schemas"]
    for path, methods in document["paths"].items():
        for operation in methods.values():
            assert path == "/livez" or "application/problem+json" in operation["responses"]["4XX"]["content"]
            assert "422" not in operation["responses"]
            assert operation["description"]


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(0, 3 * CHUNK_BYTES), max_size=4), st.integers(0, 3 * CHUNK_BYTES))
def test_answers_of_any_size_fit_in_messages_and_come_together_again(sizes: list[int], gaussian_bytes: int) -> None:
    match = Match(1, "mug", 0.75, 0.5, "things", 60, True)
    masks = tuple(
        ViewMask("", index, size, RleMask(4, 5, "".join(map(chr, range(48, 112))) * (size // 64)))
        for index, size in enumerate(sizes)
    )
    mask3d = bytes(range(256)) * (gaussian_bytes // 256)
    messages = list(messages_of(QueryAnswer("s", "1", Answer("mug", "exact", (match,), "Here."), 1, 9, masks, mask3d)))
    assert all(message.ByteSize() < MAX_MESSAGE_BYTES for message in messages)
    (whole,) = joined(messages)
    assert whole.mask3d == mask3d and whole.answer.matches[0].relevancy == 0.75
    assert [(m.camera_index, m.segmentation.counts, m.area) for m in whole.masks] == [
        (m.camera_index, m.rle.counts, m.area) for m in masks
    ]
