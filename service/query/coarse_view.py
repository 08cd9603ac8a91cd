"""Fast rendering of a simplified large scene while a camera moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.drawing.scene_renderer import Renderer
from fastsplat.service.query.objects.object_history import scene_history
from fastsplat.service.query.objects.object_index import SceneObjects
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import ObjectScene
from fastsplat_contract.geometry.camera import PosedCamera


class CoarseView:
    """Renderer of a coarse scene with objects (see `coarse_scene`); thread-safe."""

    def __init__(self, scene: ObjectScene, settings: QuerySettings) -> None:
        self.scene = scene
        self._renderer = Renderer(scene, settings)
        self.objects = SceneObjects(scene, True, self._renderer.id_map, scene_history(scene))

    def render(self, posed: PosedCamera) -> NDArray[np.uint8]:
        """Renders colors on black, uint8 [H, W, 3]."""
        return self._renderer.colors(posed)
