"""Calibrations of image-text models on disk, in the models' folders."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.image_text import ClipImageText, open_image_text
from fastsplat.service.perception.models.model_manifest import find_model, has_files
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.query.language.meaning.common_objects import all_common_objects, common_objects_digest
from fastsplat.service.query.phrases.object_looks import Calibration, LooksModel
from fastsplat_contract.errors import ModelUnavailableError

FACTS, EMBEDDINGS = "calibration.json", "calibration.npy"
"""Files in the model's folder, beside the pull's receipt."""


def save_calibration(calibration: Calibration, common: NDArray[np.float16], models: Path) -> None:
    """Writes a calibration, and the embeddings of common objects, into the model's folder."""
    folder = _folder(calibration.model, models)
    np.save(folder / EMBEDDINGS, common)
    (folder / FACTS).write_text(json.dumps(calibration.model_dump(mode="json"), indent=1) + "\n", "utf-8")


def load_calibration(model: ClipImageText, models: Path) -> LooksModel | None:
    """Reads a model's calibration; None if it was never made, or for other files or another list of objects.

    Raises `ModelUnavailableError` if it is damaged.
    """
    folder = _folder(model.name, models)
    try:
        calibration = Calibration.model_validate_json((folder / FACTS).read_text("utf-8"))
        common = np.load(folder / EMBEDDINGS, allow_pickle=False)
        if common.dtype != np.float16 or common.ndim != 2 or len(common) != len(all_common_objects()):
            raise ValueError(f"{EMBEDDINGS} is {common.dtype} {common.shape}")
    except FileNotFoundError:
        return None
    except (ValueError, OSError) as error:
        raise ModelUnavailableError(
            f"model {model.name}: {FACTS} or {EMBEDDINGS} in {folder} is damaged",
            field=model.name,
            hint="Remove both, and calibrate the model again.",
        ) from error
    known = (calibration.sha256, calibration.common_objects) == (model.sha256, common_objects_digest())
    return LooksModel(model, calibration, common) if known else None


def find_looks(settings: PerceptionSettings, models: Path) -> LooksModel | None:
    """Opens the model of `settings.image_text` if it is here and calibrated, else None.

    Raises `ModelUnavailableError` if a file is damaged."""
    name = settings.image_text
    if not has_files(name, "image_text", models) or not (_folder(name, models) / FACTS).is_file():
        return None
    return load_calibration(open_image_text(settings, models), models)


def _folder(name: str, models: Path) -> Path:
    return models / find_model(name, "image_text")[1]
