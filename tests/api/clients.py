"""The same question by both protocols, with the answers as the service's own types."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from fastsplat_client import Client, Retry
from fastsplat_contract.errors import FastSplatError
from fastsplat_contract.server.server_status import ServerHealth
from tests.api.served import Faces


def client_of(faces: Faces, **options: Any) -> Client:
    """The typed client of a running server; it repeats nothing, and waits for what takes a busy machine minutes."""
    return Client(
        str(faces.rest.base_url),
        grpc_target=f"127.0.0.1:{faces.ports.grpc}",
        **{"retry": Retry(tries=1), "timeout_s": 600.0, **options},
    )


def outcome(call: Any) -> Any:
    """What a call returns, or the error's words."""
    try:
        return call()
    except FastSplatError as error:
        return type(error), error.message, error.details()


def assert_same(actual: Any, expected: Any) -> None:
    """Equal in everything, numbers to 1e-6; masks and texts to the byte."""
    if isinstance(actual, float) or isinstance(expected, float):
        assert actual == pytest.approx(expected, abs=1e-6)
    elif isinstance(actual, ServerHealth):  # seconds of silence and of waiting, and free bytes are those of the moment
        assert isinstance(expected, ServerHealth) and actual.disk.total_bytes == expected.disk.total_bytes
        assert (actual.queue.waiting, actual.queue.running) == (expected.queue.waiting, expected.queue.running)
    elif dataclasses.is_dataclass(actual) and not isinstance(actual, type):
        assert type(actual) is type(expected)
        for field in dataclasses.fields(actual):
            assert_same(getattr(actual, field.name), getattr(expected, field.name))
    elif isinstance(actual, np.ndarray):
        assert np.allclose(actual, expected, atol=1e-6)
    elif isinstance(actual, tuple):
        assert isinstance(expected, tuple) and len(actual) == len(expected), (actual, expected)
        for mine, theirs in zip(actual, expected, strict=True):
            assert_same(mine, theirs)
    else:
        assert actual == expected
