"""The trained scene: its arrays, its files, its exchange formats."""

from fastsplat.service.scene.ply import read_ply, write_ply
from fastsplat.service.scene.scene_files import read_scene, write_scene
from fastsplat.service.scene.types import (
    CodeSemantics,
    Evidence,
    Gaussians,
    LabelMode,
    Parts,
    Scene,
    SemanticHead,
    Semantics,
    Thing,
    Things,
    semantics_of,
)

__all__ = [
    "CodeSemantics",
    "Evidence",
    "Gaussians",
    "LabelMode",
    "Parts",
    "Scene",
    "SemanticHead",
    "Semantics",
    "Thing",
    "Things",
    "read_ply",
    "read_scene",
    "semantics_of",
    "write_ply",
    "write_scene",
]
