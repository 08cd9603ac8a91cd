"""Where a splat without photos is looked at from: its bulk, what is up, and poses that show it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.capture_files import load_capture
from fastsplat.service.capture.uploads.splat_input import load_splat
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import ProgressEvent, silent
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat.service.splat_import.bulk import find_bulk
from fastsplat.service.splat_import.pictures import render_views
from fastsplat.service.splat_import.splat_import_settings import SplatImportSettings
from fastsplat.service.splat_import.viewpoints import axis_vector, choose_viewpoints, estimate_up, trial_camera
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.rendering import accumulate_weights
from fastsplat_contract.errors import CancelledError, InvalidInputError
from fastsplat_contract.geometry.poses import look_at

_CAMERA = trial_camera(60.0)


def corner(seed: int = 0) -> Gaussians:
    """A floor of 4 × 4 m with two walls, and boxes on it; all of it flat Gaussians in their surfaces."""
    rng = np.random.default_rng(seed)
    parts = [_panel(rng, 3_000, (-2, -2, 0), (2, 2, 0)), _panel(rng, 1_200, (-2, 2, 0), (2, 2, 2))]
    parts.append(_panel(rng, 1_200, (-2, -2, 0), (-2, 2, 2)))
    for x, y, size in ((0.0, 0.0, 0.5), (-0.8, 0.7, 0.4), (0.8, -0.6, 0.3)):
        parts.append(_panel(rng, 500, (x, y, size), (x + size, y + size, size)))
        for low, high in (
            ((x, y, 0), (x + size, y, size)),
            ((x, y + size, 0), (x + size, y + size, size)),
            ((x, y, 0), (x, y + size, size)),
            ((x + size, y, 0), (x + size, y + size, size)),
        ):
            parts.append(_panel(rng, 400, low, high))
    means, log_scales = (np.concatenate(pieces).astype(np.float32) for pieces in zip(*parts, strict=True))
    count = len(means)
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
    sh = rng.normal(0, 0.5, (count, 1, 3)).astype(np.float32)
    return Gaussians(means, quats, log_scales, np.full(count, 4, np.float32), sh, np.zeros((count, 0), np.float32))


def _panel(
    rng: np.random.Generator, count: int, low: tuple[float, ...], high: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Means and log scales of a rectangle that is flat along one axis."""
    extent = np.subtract(high, low)
    spread = np.sqrt(np.prod(extent[extent > 0]) / count)
    return rng.uniform(low, high, (count, 3)), np.tile(np.log(np.where(extent > 0, spread, 0.002)), (count, 1))


def moved(gaussians: Gaussians, rotation: Rotation, shift: np.ndarray, scale: float) -> Gaussians:
    """The same splat in another world."""
    xyzw = (rotation * Rotation.from_quat(gaussians.quats[:, [1, 2, 3, 0]])).as_quat()
    return replace(
        gaussians,
        means=(scale * rotation.apply(gaussians.means) + shift).astype(np.float32),
        quats=xyzw[:, [3, 0, 1, 2]].astype(np.float32),
        log_scales=(gaussians.log_scales + np.log(scale)).astype(np.float32),
    )


def test_the_bulk_moves_with_the_world_and_ignores_far_and_faint_gaussians() -> None:
    gaussians = corner()
    bulk = find_bulk(gaussians)
    shift = np.array([5.0, -3.0, 1.0])
    moved_bulk = find_bulk(moved(gaussians, Rotation.identity(), shift, 2.0))
    np.testing.assert_allclose(moved_bulk.center, 2 * bulk.center + shift, atol=1e-4)
    assert moved_bulk.radius == pytest.approx(2 * bulk.radius, rel=1e-4)
    means, logits = gaussians.means.copy(), gaussians.logit_opacities.copy()
    means[::10] *= 1e4
    logits[::10] = -6.0
    faint = find_bulk(replace(gaussians, means=means, logit_opacities=logits))
    assert np.linalg.norm(faint.center - bulk.center) < 0.1 * bulk.radius
    assert faint.radius == pytest.approx(bulk.radius, rel=0.1)


def test_a_splat_in_one_place_has_no_bulk() -> None:
    gaussians = corner()
    with pytest.raises(InvalidInputError, match="one place"):
        find_bulk(replace(gaussians, means=np.zeros_like(gaussians.means)))


@pytest.mark.parametrize("custom", ["z", "-y", "y"])
@pytest.mark.parametrize("tilt_deg", [0.0, 25.0])
def test_up_is_found_in_worlds_of_every_custom(custom: str, tilt_deg: float) -> None:
    rng = np.random.default_rng(len(custom))
    to_custom, _ = Rotation.align_vectors([axis_vector(custom)], [[0.0, 0, 1]])
    axis = np.cross(axis_vector(custom), rng.normal(size=3))
    tilt = Rotation.from_rotvec(np.radians(tilt_deg) * axis / np.linalg.norm(axis))
    turned = tilt * to_custom
    gaussians = moved(corner(), turned, np.array([3.0, 2.0, -1.0]), 0.7)
    up = estimate_up(gaussians, find_bulk(gaussians))
    assert up @ turned.apply([0.0, 0, 1]) > np.cos(np.radians(5))


def test_a_pose_looks_at_its_target_with_its_head_up() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        position, target, up = rng.normal(size=(3, 3))
        up /= np.linalg.norm(up)
        pose = look_at(position, target, up)
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
        inside = np.linalg.inv(pose) @ [*target, 1]
        np.testing.assert_allclose(inside[:2], 0, atol=1e-9)
        assert inside[2] > 0 and pose[:3, 0] @ up == pytest.approx(0, abs=1e-9) and pose[:3, 1] @ up <= 1e-9
    down = look_at(np.array([0.0, 0, 2]), np.zeros(3), np.array([0.0, 0, 1]))
    assert np.linalg.det(down[:3, :3]) == pytest.approx(1)


def test_views_show_everything_that_matters_and_none_from_behind_a_wall() -> None:
    gaussians = corner()
    bulk = find_bulk(gaussians)
    up = np.array([0.0, 0, 1])
    poses = choose_viewpoints(gaussians, bulk, up, 20, 60.0)
    assert 10 <= len(poses) <= 20
    splats = splats_of(gaussians)
    unit_image = torch.ones(_CAMERA.height, _CAMERA.width, 1)
    seen = np.zeros(len(gaussians), int)
    for pose in poses:
        position = pose[:3, 3]
        assert position[0] > -2 and position[1] < 2 and position[2] > 0  # before both walls, above the floor
        viewmat = torch.from_numpy(np.linalg.inv(pose).astype(np.float32))
        seen += accumulate_weights(splats, viewmat, _CAMERA, unit_image)[:, 0].numpy() > 0.05
    tops = gaussians.means[:, 2] > 0.01
    inner = tops & (np.abs(gaussians.means[:, 0]) < 1.5) & (np.abs(gaussians.means[:, 1]) < 1.5)
    assert (seen[inner] > 0).mean() > 0.9


def test_a_splat_that_shows_nothing_is_refused() -> None:
    gaussians = replace(corner(), logit_opacities=np.full(len(corner()), -16, np.float32))
    with pytest.raises(InvalidInputError, match="nothing of the splat can be seen"):
        choose_viewpoints(gaussians, find_bulk(gaussians), np.array([0.0, 0, 1]), 4, 60.0)


@pytest.fixture
def validated(tmp_path: Path) -> Path:
    """A splat alone, checked; its world is COLMAP's, −y up."""
    turned = moved(corner(), Rotation.from_euler("x", 90, degrees=True), np.zeros(3), 1.0)
    (tmp_path / "upload").mkdir()
    write_ply(turned, tmp_path / "upload" / "corner.ply")
    return validate_upload(tmp_path / "upload", CaptureSettings()).folder


@pytest.mark.parametrize("up", [None, "-y"])
def test_pictures_are_a_capture_of_the_splat(validated: Path, tmp_path: Path, up: str | None) -> None:
    settings = SplatImportSettings(pictures=6, picture_side=64)
    heard: list[ProgressEvent] = []
    capture = render_views(validated, tmp_path / "capture", settings, heard.append, up=up)
    assert capture.report.source == "splat" and capture.report.splat == "corner.ply"
    assert any("estimated" in warning for warning in capture.report.warnings) == (up is None)
    assert len(capture.views) == 6 and len({view.posed.name for view in capture.views}) == 6
    for view in capture.views:
        assert view.posed.camera.width == 64 and view.posed.world_from_camera[:3, 1] @ [0, -1, 0] < 0.2
    assert capture.splat is not None
    np.testing.assert_array_equal(load_splat(capture.splat).means, load_splat(validated / "splat.safetensors").means)
    assert load_capture(tmp_path / "capture").splat == capture.splat
    fractions = [event.fraction for event in heard]
    assert fractions == sorted(fractions) and fractions[-1] == 1 and {event.stage for event in heard} == {"capture"}


def test_a_cancelled_search_leaves_nothing(validated: Path, tmp_path: Path) -> None:
    def cancel(event: ProgressEvent) -> None:
        raise CancelledError("enough")

    with pytest.raises(CancelledError):
        render_views(validated, tmp_path / "capture", SplatImportSettings(pictures=2), cancel)
    assert not (tmp_path / "capture").exists()
    render_views(validated, tmp_path / "capture", SplatImportSettings(pictures=2, picture_side=64), silent)
