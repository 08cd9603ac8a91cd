"""Grades a scene's quality from figures measured while it was trained.

Origin of the thresholds: 26 steps on a busy machine gave 13.7 dB and a blur; photos with changing exposure stay at 18
to 24 dB after about 500 steps although the geometry is right; the sample and the table top pass 28 dB in a draft.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.scene_facts import SceneFacts
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.messages.assessments import Assessment, Finding, Grade

_ORDER: tuple[Grade, ...] = ("poor", "fair", "good")
_POOR_STEPS, _FAIR_STEPS = 250, 1_000
_POOR_PSNR_DB, _FAIR_PSNR_DB = 18.0, 22.0
_POOR_SHARE, _FAIR_SHARE = 0.5, 0.8
_POOR_PHOTOS, _FAIR_PHOTOS = 6, 15
_POOR_SPREAD_DEG, _FAIR_SPREAD_DEG = 8.0, 25.0
_FAIR_ERROR_PX = 1.5
_OVERRUN = 1.25
_FACING = 0.8  # share of cameras that must face the common point
_MOST_CAMERAS = 200


def assess(quality: Mapping[str, Any], facts: SceneFacts, cameras: Sequence[PosedCamera]) -> Assessment | None:
    """Grades a scene and lists findings that lower its quality, worst first.

    Returns:
        None if nothing was measured, e.g. for an imported splat without photos.
    """
    if facts.source == "splat" or "images" not in quality:
        return None
    findings = sorted(_findings(quality, facts, cameras), key=lambda finding: _ORDER.index(finding.grade))
    return Assessment(findings[0].grade if findings else "good", tuple(findings))


def _findings(quality: Mapping[str, Any], facts: SceneFacts, cameras: Sequence[PosedCamera]) -> Iterator[Finding]:
    images, registered = _number(quality, "images"), _number(quality, "registered")
    # The exposure of held-out photos is unknown where exposure varies: compare color-corrected PSNR.
    name = "psnr_cc" if "photometric" in quality else "psnr"
    steps, psnr = _number(quality, "iterations"), _number(quality, name)
    if registered is not None and (grade := _below(registered, _POOR_PHOTOS, _FAIR_PHOTOS)):
        yield Finding(
            "FEW_PHOTOS",
            grade,
            f"The scene rests on {registered:.0f} photos.",
            "Take 20 to 200, a small step to the side between one and the next, from all around.",
        )
    if images and registered is not None and (grade := _below(registered / images, _POOR_SHARE, _FAIR_SHARE)):
        yield Finding(
            "PHOTOS_NOT_PLACED",
            grade,
            f"{registered:.0f} of {images:.0f} photos could be placed.",
            "Take more photos between those that were placed and those that were not, each overlapping its neighbors "
            "by two thirds.",
        )
    spread = viewing_spread_deg(cameras)
    if spread is not None and (grade := _below(spread, _POOR_SPREAD_DEG, _FAIR_SPREAD_DEG)):
        yield Finding(
            "ONE_SIDE_ONLY",
            grade,
            f"The photos look at the place from directions at most {spread:.0f} degrees apart.",
            "Walk around what matters: depth is known only where directions differ.",
        )
    if steps is not None and not quality.get("enough") and (grade := _below(steps, _POOR_STEPS, _FAIR_STEPS)):
        yield Finding(
            "FEW_STEPS",
            grade,
            f"Training ended after {steps:.0f} steps.",
            "Train again with more time, or when the machine is less busy.",
        )
    if psnr is not None and quality.get("held_out") and (grade := _below(psnr, _POOR_PSNR_DB, _FAIR_PSNR_DB)):
        yield Finding(
            "PICTURES_DIFFER",
            grade,
            f"Photos that training did not see are reproduced with {psnr:.1f} dB.",
            "Look for motion, blur and changing light in the photos; train longer if they are steady.",
        )
    error = _number(quality, "mean_reprojection_error_px")
    if error is not None and error > _FAIR_ERROR_PX:
        yield Finding(
            "POSES_INEXACT",
            "fair",
            f"The cameras' poses fit the photos to {error:.1f} pixels.",
            "Leave out blurred photos, and do not mix cameras or zoom.",
        )
    # A default time budget is no promise: training may exceed it to reach the minimum steps.
    budget = _number(quality, "time_budget_s") if facts.time_asked_s is not None else None
    took = _number(quality, "train_seconds")
    if budget and took is not None and took > _OVERRUN * budget:
        yield Finding(
            "TOOK_LONGER",
            "fair",
            f"Training took {took:.0f} s in place of {budget:.0f} s, to reach the fewest steps that make a scene.",
            "Give it more time, a smaller scene, or a machine that is less busy.",
        )


def viewing_spread_deg(cameras: Sequence[PosedCamera]) -> float | None:
    """Returns the largest angle between cameras' directions to their `common_point`, None without one."""
    point = common_point(cameras)
    if point is None:
        return None
    some = cameras[:: max(1, len(cameras) // _MOST_CAMERAS)]
    toward = point - np.stack([posed.world_from_camera[:3, 3] for posed in some]).astype(np.float64)
    directions = toward / np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
    return float(np.degrees(np.arccos(np.clip((directions @ directions.T).min(), -1, 1))))


def common_point(cameras: Sequence[PosedCamera]) -> NDArray[np.float64] | None:
    """Returns the point nearest to all optical axes by least squares, float64 [3].

    Returns:
        None for fewer than two cameras, or without a common point, e.g. photos taken outwards from a room's middle.
    """
    if len(cameras) < 2:
        return None
    some = cameras[:: max(1, len(cameras) // _MOST_CAMERAS)]
    poses = np.stack([posed.world_from_camera for posed in some]).astype(np.float64)
    centers, axes = poses[:, :3, 3], poses[:, :3, 2]
    across: NDArray[np.float64] = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    solution, _, rank, _ = np.linalg.lstsq(across.sum(0), np.einsum("nij,nj->i", across, centers), rcond=1e-9)
    depth = np.einsum("ni,ni->n", solution - centers, axes)
    if rank < 3 or np.mean(depth > 0) < _FACING:
        return None
    return np.asarray(solution)


def _number(quality: Mapping[str, Any], name: str) -> float | None:
    value = quality.get(name)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _below(value: float, poor: float, fair: float) -> Grade | None:
    return "poor" if value < poor else "fair" if value < fair else None
