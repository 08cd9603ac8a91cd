"""Leakage of test views into training."""

from __future__ import annotations

import numpy as np

from fastsplat.service.evaluation.datasets.types import Dataset
from fastsplat.service.scene.types import Scene
from fastsplat_contract.errors import InvalidInputError

_SAME = 1e-4


def check_unseen(scene: Scene, dataset: Dataset) -> None:
    """Raise if the scene was trained on a test view, by the image's name or by its pose.

    A scene's cameras are what it was trained on, but for those its quality names as held out.

    Raises:
        InvalidInputError: the scene saw a test view, or an image of the same name has another pose in it.
    """
    held_out = set(scene.quality.get("held_out_views", ()))
    trained = [posed for posed in scene.cameras if posed.name not in held_out]
    names = {posed.name for posed in trained}
    stated = {posed.name: posed.world_from_camera for posed in scene.cameras}
    for view in dataset.test:
        leaked = view.name in names
        if view.posed is not None:
            pose = view.posed.world_from_camera
            leaked = leaked or any(np.abs(posed.world_from_camera - pose).max() < _SAME for posed in trained)
        if leaked:
            raise InvalidInputError(
                f"the scene was trained on the test view {view.name}",
                field="scene",
                hint="Train it on the data set's training split alone: fastsplat evaluate does, without --scene.",
            )
        if view.posed is not None and view.name in stated and np.abs(stated[view.name] - pose).max() > _SAME:
            raise InvalidInputError(
                f"{view.name} has another pose in the scene than in {dataset.folder.name}",
                field="scene",
                hint="Give the scene the data set's own poses; a reconstruction of its own has another world frame.",
            )
