"""All types of the contract, found by walking its modules."""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any

import fastsplat_contract
from fastsplat_contract.codec.wire import Message


def _types() -> dict[str, Any]:
    found: dict[str, Any] = {}
    for _, name, _ in pkgutil.walk_packages(fastsplat_contract.__path__, "fastsplat_contract."):
        if ".v1" in name:
            continue
        for value in vars(importlib.import_module(name)).values():
            travels = isinstance(value, type) and (issubclass(value, Message) or hasattr(value, "as_named"))
            if travels and value.__module__ == name and name != Message.__module__:
                assert value.__name__ not in found, f"two types are called {value.__name__}"
                found[value.__name__] = value
    return found


TYPES = _types()  # by name; cameras as they travel, see `viewpoint.PosedCamera`
