"""The trained artefact: its arrays, its files, its exchange formats."""

from fastsplat.service.scene.files import read_scene, write_scene
from fastsplat.service.scene.ply import read_ply, write_ply
from fastsplat.service.scene.types import Evidence, Gaussians, LabelMode, Scene, SemanticHead

__all__ = [
    "Evidence",
    "Gaussians",
    "LabelMode",
    "Scene",
    "SemanticHead",
    "read_ply",
    "read_scene",
    "write_ply",
    "write_scene",
]
