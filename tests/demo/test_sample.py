"""Laws of the committed sample capture: it is complete, small, and its pictures, masks and poses agree."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.uploads.upload_validation import validate_upload

SAMPLE = Path(__file__).resolve().parents[2] / "demo" / "sample"
_LIMIT_BYTES = 5_000_000


@pytest.fixture(scope="module")
def transforms() -> dict:
    return json.loads((SAMPLE / "transforms.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def labels(transforms: dict) -> dict[str, int]:
    return transforms["labels"]


@pytest.fixture(scope="module")
def masks(transforms: dict) -> list[NDArray[np.uint8]]:
    return [np.asarray(Image.open(SAMPLE / frame["mask_path"])) for frame in transforms["frames"]]


@pytest.fixture(scope="module")
def poses(transforms: dict) -> NDArray[np.float64]:
    """World-from-camera in OpenCV axes, [N, 4, 4]."""
    stored = np.array([frame["transform_matrix"] for frame in transforms["frames"]], float)
    return stored @ np.diag([1.0, -1.0, -1.0, 1.0])


def test_files_are_complete_and_small(transforms: dict) -> None:
    frames = transforms["frames"]
    assert 24 <= len(frames) <= 28
    assert {f["file_path"] for f in frames} == {f"images/{p.name}" for p in (SAMPLE / "images").iterdir()}
    assert {f["mask_path"] for f in frames} == {f"masks/{p.name}" for p in (SAMPLE / "masks").iterdir()}
    assert all(Path(f["file_path"]).stem == Path(f["mask_path"]).stem for f in frames)
    sizes = {Image.open(SAMPLE / frame[key]).size for frame in frames for key in ("file_path", "mask_path")}
    assert sizes == {(transforms["w"], transforms["h"])}
    assert (SAMPLE / "README.md").is_file()
    assert sum(p.stat().st_size for p in SAMPLE.rglob("*") if p.is_file()) < _LIMIT_BYTES


def test_mask_ids_are_the_labels(labels: dict[str, int], masks: list[NDArray[np.uint8]]) -> None:
    assert sorted(labels.values()) == list(range(1, len(labels) + 1))
    found = {int(i) for mask in masks for i in np.unique(mask)}
    assert found == {0, *labels.values()}


def test_rays_through_one_object_meet(
    transforms: dict, labels: dict[str, int], masks: list[NDArray[np.uint8]], poses: NDArray[np.float64]
) -> None:
    """Rays through the middle of a compact object's mask pass within 3 cm of one point: masks, poses and axes agree."""
    turns = poses[:, :3, :3]
    np.testing.assert_allclose(np.linalg.inv(turns), turns.transpose(0, 2, 1), atol=1e-4)
    for name in ("clock", "cup", "bowl", "vase", "teddy bear", "banana"):
        rays = []
        for mask, pose in zip(masks, poses, strict=True):
            rows, columns = np.nonzero(mask == labels[name])
            whole = len(rows) and rows.min() > 0 and columns.min() > 0 and rows.max() < mask.shape[0] - 1
            if len(rows) < 400 or not whole or columns.max() == mask.shape[1] - 1:
                continue
            middle = np.array([(columns.min() + columns.max() + 1) / 2, (rows.min() + rows.max() + 1) / 2])
            slope = (middle - (transforms["cx"], transforms["cy"])) / (transforms["fl_x"], transforms["fl_y"])
            ray = pose[:3, :3] @ np.array([*slope, 1.0])
            rays.append((pose[:3, 3], ray / np.linalg.norm(ray)))
        assert len(rays) >= 8, name
        across = np.stack([np.eye(3) - np.outer(ray, ray) for _, ray in rays])
        origins = np.stack([origin for origin, _ in rays])
        point = np.linalg.solve(across.sum(0), np.einsum("nij,nj->i", across, origins))
        miss = np.linalg.norm(np.einsum("nij,nj->ni", across, point - origins), axis=1)
        assert np.median(miss) < 0.03, (name, miss)
        assert np.linalg.norm(point[:2]) < 0.5 and 0.0 < point[2] < 0.2, (name, point)


def test_the_whole_folder_is_a_capture_with_poses_and_labels(tmp_path: Path) -> None:
    """Uploaded as it is, it needs neither structure from motion nor a detector."""
    shutil.copytree(SAMPLE, tmp_path / "upload")
    admitted = validate_upload(tmp_path / "upload", CaptureSettings())
    assert admitted.source == "nerfstudio"
    assert admitted.has_labels
    assert not admitted.warnings
