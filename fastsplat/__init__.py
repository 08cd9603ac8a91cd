"""FAST-Splat scene service: photos of a place in, a 3D scene out that answers, in plain words, where objects are.

    scene = fastsplat.train("photos/")
    scene.ask("something to drink from").sentence
    scene.show("mug")

In the repository the packages are the folders beside this one (`service/`, `api/`, `workers/`, `cli/`); the links here
give them the names under which they are installed, so that `service` and `api` stay free for everybody else.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fastsplat.service.library.local_scene import LocalScene, Picture, Viewer, open_scene
    from fastsplat.service.library.sample import open_sample
    from fastsplat.service.library.training_run import train

__all__ = ["LocalScene", "Picture", "Viewer", "open_sample", "open_scene", "train"]

_MODULES = {"open_sample": "sample", "train": "training_run"}
"""Where those names are that are not in `local_scene`."""


def __getattr__(name: str) -> Any:
    """What `__all__` names loads with its first use: a worker or a command is not to wait for all of it."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"fastsplat.service.library.{_MODULES.get(name, 'local_scene')}"), name)
