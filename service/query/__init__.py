"""Plain words and poses to ranked objects, 2D masks and 3D masks. Torch loads with the first picture, not before."""

from fastsplat.service.query.embeddings import embed_labels
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.settings import QuerySettings
from fastsplat.service.query.types import Mask2D

__all__ = ["Mask2D", "QuerySettings", "SceneIndex", "embed_labels"]
