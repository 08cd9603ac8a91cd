"""Examples in docstrings hold, and what the packages export, rasterizer and losses offer has some."""

from __future__ import annotations

import doctest
import importlib
import inspect

import pytest

import fastsplat
import fastsplat_client
from fastsplat.service.splatting.losses import functional
from fastsplat.service.splatting.raster import image_formation, rendering, share_maps

_PUBLIC = {getattr(package, name) for package in (fastsplat, fastsplat_client) for name in package.__all__} | {
    value
    for module in (functional, image_formation, rendering, share_maps)
    for name, value in vars(module).items()
    if not name.startswith("_") and getattr(value, "__module__", "") == module.__name__
}
_WITHOUT = {fastsplat.train}  # takes minutes; the quickstart runs it


@pytest.mark.parametrize("name", sorted({value.__module__ for value in _PUBLIC}))
def test_examples_hold(name: str, request: pytest.FixtureRequest) -> None:
    if name.startswith(("fastsplat.service.library.", "fastsplat_client.client")):  # they open the sample
        request.getfixturevalue("models_dir")
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_what_does_something_has_an_example() -> None:
    """Records alone need none, nor do types of the wire, whose docstrings are the description of the API."""
    for value in _PUBLIC - _WITHOUT:
        parts = [value, *(member for name, member in vars(value).items() if not name.startswith("_"))]
        if any(map(inspect.isfunction, parts)) and not hasattr(value, "proto"):
            assert any(test.examples for test in doctest.DocTestFinder().find(value)), value
