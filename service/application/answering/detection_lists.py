"""Objects of finished scenes as detections for robots."""

from __future__ import annotations

from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.paging import page_of
from fastsplat.service.application.base.validate import check_page_size, check_texts
from fastsplat_contract.messages.detections import DetectionList


class Detections:
    """Full records of objects. Thread-safe."""

    def __init__(self, context: ProjectContext) -> None:
        self._context = context

    def all(self, scene_id: str, version: str = "", page_size: int = 0, page_token: str = "") -> DetectionList:
        """Every object of a scene by id, without parts, paged as `SceneService.list_scenes`."""
        from fastsplat.service.query.measures.object_detections import detections_of  # scipy loads with the first call

        check_texts(version, "version")
        size = check_page_size(page_size, self._context.settings.store)
        index, read_version = self._context.scenes.open(scene_id, version)
        page, token = page_of(index.objects.listed, size, page_token, f"detections {scene_id} {read_version}")
        named = self._context.known_names.suggest(scene_id, index.ranked, page)
        return detections_of(index, named, read_version, token)
