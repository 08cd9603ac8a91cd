"""Laws of the committed sample capture: it is complete, small, and its pictures, masks and poses agree."""

from __future__ import annotations

import json
import shutil
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.uploads.upload_validation import validate_upload

SAMPLE = Path(__file__).resolve().parents[2] / "demo" / "sample"
_LIMIT_BYTES = 5_000_000
_VISIBLE_PIXELS = 150


@pytest.fixture(scope="module")
def transforms() -> dict:
    return json.loads((SAMPLE / "transforms.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def labels() -> dict[str, int]:
    return json.loads((SAMPLE / "transforms.json").read_text(encoding="utf-8"))["labels"]


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
    assert (SAMPLE / "README.md").is_file()
    assert sum(p.stat().st_size for p in SAMPLE.rglob("*") if p.is_file()) < _LIMIT_BYTES


def test_pictures_and_masks_have_the_stated_size(transforms: dict, masks: list[NDArray[np.uint8]]) -> None:
    size = (transforms["w"], transforms["h"])
    for frame, mask in zip(transforms["frames"], masks, strict=True):
        with Image.open(SAMPLE / frame["file_path"]) as picture:
            picture.load()
            assert (picture.size, picture.mode) == (size, "RGB")
        assert mask.shape == size[::-1]
        assert mask.dtype == np.uint8


def test_mask_ids_are_the_labels(labels: dict[str, int], masks: list[NDArray[np.uint8]]) -> None:
    assert sorted(labels.values()) == list(range(1, len(labels) + 1))
    found = {int(i) for mask in masks for i in np.unique(mask)}
    assert found == {0, *labels.values()}


def test_every_label_is_seen_often(labels: dict[str, int], masks: list[NDArray[np.uint8]]) -> None:
    seen = {name: sum(int((mask == i).sum()) >= _VISIBLE_PIXELS for mask in masks) for name, i in labels.items()}
    assert min(seen.values()) >= 8, seen


def test_poses_are_rigid_and_look_at_the_table(transforms: dict, poses: NDArray[np.float64]) -> None:
    rotations = poses[:, :3, :3]
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.broadcast_to(np.eye(3), rotations.shape), atol=1e-5
    )
    assert np.all(np.linalg.det(rotations) > 0)
    np.testing.assert_array_equal(poses[:, 3], np.broadcast_to([0, 0, 0, 1.0], (len(poses), 4)))
    distance = np.linalg.norm(poses[:, :3, 3], axis=1)
    assert distance.min() > 0.6 and distance.max() < 1.2
    facing = -np.einsum("ni,ni->n", poses[:, :3, 2], poses[:, :3, 3]) / distance
    assert facing.min() > 0.98
    assert transforms["cx"] == transforms["w"] / 2 and transforms["cy"] == transforms["h"] / 2


def test_rays_through_one_object_meet(
    transforms: dict, labels: dict[str, int], masks: list[NDArray[np.uint8]], poses: NDArray[np.float64]
) -> None:
    """Rays through the middle of a compact object's mask pass within 3 cm of one point: masks, poses and axes agree."""
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


def test_no_two_pictures_are_nearly_the_same(transforms: dict, poses: NDArray[np.float64]) -> None:
    small = [
        np.asarray(Image.open(SAMPLE / f["file_path"]).convert("L").resize((60, 45)), np.float64)
        for f in transforms["frames"]
    ]
    for i, j in combinations(range(len(small)), 2):
        assert np.abs(small[i] - small[j]).mean() > 6, (i, j)
        assert np.linalg.norm(poses[i, :3, 3] - poses[j, :3, 3]) > 0.08, (i, j)


def test_neighbours_overlap(poses: NDArray[np.float64]) -> None:
    """Every view has two others within 20 degrees as seen from the table: what structure from motion lives on."""
    towards = poses[:, :3, 3] / np.linalg.norm(poses[:, :3, 3], axis=1, keepdims=True)
    angles = np.degrees(np.arccos(np.clip(towards @ towards.T, -1, 1)))
    assert np.sort(angles, axis=1)[:, 2].max() < 20.0


def test_the_whole_folder_is_a_capture_with_poses_and_labels(tmp_path: Path) -> None:
    """Uploaded as it is, it needs neither structure from motion nor a detector."""
    shutil.copytree(SAMPLE, tmp_path / "upload")
    admitted = validate_upload(tmp_path / "upload", CaptureSettings())
    assert admitted.source == "nerfstudio"
    assert admitted.has_labels
    assert not admitted.warnings
