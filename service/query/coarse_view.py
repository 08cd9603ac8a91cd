"""Fast rendering of a simplified large scene while a camera moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.drawing.scene_renderer import Renderer
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.things.thing_history import scene_history
from fastsplat.service.query.things.thing_index import SceneThings
from fastsplat.service.scene.artefact.scene import Parts, Things, ThingScene
from fastsplat_contract.geometry.camera import PosedCamera


class CoarseView:
    """Renderer of a coarse scene with things (see `coarse_scene`); thread-safe."""

    def __init__(self, scene: ThingScene, settings: QuerySettings) -> None:
        self.scene = scene
        self._renderer = Renderer(scene, settings)
        self.things = SceneThings(scene, True, self._map, scene_history(scene))

    def render(self, posed: PosedCamera) -> NDArray[np.uint8]:
        """Renders colors on black, uint8 [H, W, 3]."""
        return self._renderer.colors(posed)

    def _map(self, posed: PosedCamera, things: Things | Parts) -> NDArray[np.uint16]:
        if isinstance(things, Parts):
            return self._renderer.part_map(posed, things)
        return self._renderer.thing_map(posed, things)
