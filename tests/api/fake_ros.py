"""A stand-in for rclpy (not on PyPI) with rosbags' strict messages; ranges, QoS and executor are untried."""

from __future__ import annotations

import array
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from fastsplat_ros2.bag import types_with_vision

_FIND = Path(__file__).parents[2] / "examples/ros2/fastsplat_interfaces/srv/Find.srv"


class FakeNode:
    """What a node asks of rclpy."""

    parameters: dict[str, Any]

    def __init__(self, name: str) -> None:
        self.name = name
        self.published: list[tuple[str, Any]] = []
        self.services: dict[str, Any] = {}
        self.timers: list[tuple[float, Any]] = []
        self.log: list[tuple[str, str]] = []
        self._values: dict[str, Any] = {}

    def declare_parameter(self, name: str, default: Any) -> None:
        self._values[name] = self.parameters.get(name, default)

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=self._values[name])

    def create_publisher(self, kind: type, topic: str, profile: Any) -> Any:
        def publish(message: Any) -> None:
            assert isinstance(message, kind)
            self.published.append((topic, message))

        return SimpleNamespace(publish=publish)

    def create_service(self, kind: Any, name: str, answer: Any) -> None:
        self.services[name] = answer

    def create_timer(self, period: float, call: Any) -> None:
        self.timers.append((period, call))

    def get_logger(self) -> Any:
        return SimpleNamespace(
            error=lambda text: self.log.append(("error", text)), warning=lambda text: self.log.append(("warning", text))
        )


class _Transforms:
    def __init__(self, node: FakeNode) -> None:
        self._node = node

    def sendTransform(self, transform: Any) -> None:  # noqa: N802 - as tf2 calls it
        self._node.published.append(("/tf_static", transform))


def find_fields() -> tuple[dict[str, str], dict[str, str]]:
    """The fields of Find.srv, of request and response: types by name."""
    halves = _FIND.read_text().split("---\n")
    rows = [[line.split("#")[0].split() for line in half.splitlines()] for half in halves]
    request, response = ({row[1]: row[0] for row in half if row} for half in rows)
    return request, response


def install_fake_ros(monkeypatch: pytest.MonkeyPatch, parameters: dict[str, Any]) -> None:
    """Put the stand-ins where the node imports them from."""
    store = types_with_vision()

    def get_message(name: str) -> type:
        return store.types[name]

    def module(name: str, **contents: Any) -> None:
        fake_module = ModuleType(name)
        vars(fake_module).update(contents)
        monkeypatch.setitem(sys.modules, name, fake_module)

    module("rclpy")
    module("rclpy.executors", ExternalShutdownException=RuntimeError)
    module("rclpy.node", Node=type("Node", (FakeNode,), {"parameters": parameters}))
    module("rclpy.qos", DurabilityPolicy=SimpleNamespace(TRANSIENT_LOCAL=1), QoSProfile=SimpleNamespace)
    module("rosidl_runtime_py")
    module("rosidl_runtime_py.utilities", get_message=get_message)
    module("tf2_ros", StaticTransformBroadcaster=_Transforms)
    module("fastsplat_interfaces")
    module("fastsplat_interfaces.srv", Find=SimpleNamespace())


class FakeResponse:
    """A response of Find, with the fields that its definition has and no other."""

    def __init__(self) -> None:
        _, fields = find_fields()
        empty = {"bool": False, "string": "", "float64": 0.0}
        vars(self).update({name: empty.get(kind) for name, kind in fields.items()})

    def __setattr__(self, name: str, value: Any) -> None:
        kinds = {"bool": bool, "string": str, "float64": float}
        kind = find_fields()[1][name]  # a KeyError: there is no such field
        if kind in kinds:
            assert type(value) is kinds[kind]
        else:
            assert type(value).__name__.endswith(kind.partition("/")[2])
        vars(self)[name] = value


def is_rclpy_array(value: Any) -> bool:
    """Whether rclpy takes a value for an unbounded array of bytes."""
    return isinstance(value, array.array)
