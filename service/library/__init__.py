"""Scenes in a notebook or a script, without a server."""

from fastsplat.service.library.local_scene import LocalScene, Picture, open_scene
from fastsplat.service.library.sample import open_sample, sample_folder
from fastsplat.service.library.training_run import train
from fastsplat.service.library.viewer import Viewer

__all__ = ["LocalScene", "Picture", "Viewer", "open_sample", "open_scene", "sample_folder", "train"]
