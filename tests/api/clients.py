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


def assert_same(one: Any, other: Any) -> None:
    """Equal in everything, numbers to 1e-6; masks and texts to the byte."""
    if isinstance(one, float) or isinstance(other, float):
        assert one == pytest.approx(other, abs=1e-6)
    elif isinstance(one, ServerHealth):  # seconds of silence and of waiting, and free bytes are those of the moment
        assert isinstance(other, ServerHealth) and one.disk.total_bytes == other.disk.total_bytes
        assert (one.queue.waiting, one.queue.running) == (other.queue.waiting, other.queue.running)
    elif dataclasses.is_dataclass(one) and not isinstance(one, type):
        assert type(one) is type(other)
        for field in dataclasses.fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, np.ndarray):
        assert np.allclose(one, other, atol=1e-6)
    elif isinstance(one, tuple):
        assert isinstance(other, tuple) and len(one) == len(other), (one, other)
        for mine, theirs in zip(one, other, strict=True):
            assert_same(mine, theirs)
    else:
        assert one == other
