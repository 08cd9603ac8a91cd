"""Data sets with a truth: what a scene may be trained on, and what it is measured on."""

from fastsplat.service.evaluation.datasets.reading import read_dataset
from fastsplat.service.evaluation.datasets.training import training_capture
from fastsplat.service.evaluation.datasets.types import Dataset, QueryTruth, TrueView

__all__ = ["Dataset", "QueryTruth", "TrueView", "read_dataset", "training_capture"]
