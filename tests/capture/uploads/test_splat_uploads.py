"""Uploads that bring a splat: alone, beside posed photos, in nerfstudio's own world, and broken ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.untrusted.sandbox import validate_in_sandbox
from fastsplat.service.capture.uploads.splat_input import load_splat
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.formats.zips import zipped
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from tests.capture.splat_writers import columns_of, write_table
from tests.capture.upload_files import PINHOLE, frames_of
from tests.scene.conftest import make_gaussians


def splat_bytes(tmp_path: Path, gaussians: Gaussians | None = None) -> bytes:
    write_table(tmp_path / "own.ply", columns_of(gaussians or make_gaussians(40, 4, 0)))
    content = (tmp_path / "own.ply").read_bytes()
    (tmp_path / "own.ply").unlink()
    return content


def _transforms(names: list[str], **extra: object) -> bytes:
    pose = np.eye(4)
    pose[2, 3] = 3.0
    return json.dumps({**PINHOLE, "frames": frames_of(names, pose), **extra}).encode()


@pytest.mark.parametrize("sent", ["desk.ply", "desk.zip"])
def test_a_splat_alone(sent: str, upload, settings, tmp_path: Path) -> None:
    gaussians = make_gaussians(40, 4, 0)
    content = splat_bytes(tmp_path, gaussians)
    sent_bytes = content if sent.endswith(".ply") else zipped({"export/desk.ply": content})
    validated = validate_in_sandbox(upload({sent: sent_bytes}), settings)
    assert (validated.source, validated.images, validated.gaussians) == ("splat", 0, 40)
    rows = load_splat(validated.folder / "splat.safetensors")
    np.testing.assert_array_equal(rows.means, gaussians.means)
    with pytest.raises(InvalidInputError, match="has no views"):
        build_capture(validated.folder, tmp_path / "capture", settings, silent)


def test_posed_photos_and_a_splat_are_one_capture(upload, photo, settings, tmp_path: Path) -> None:
    gaussians = make_gaussians(40, 4, 0)
    files = {"desk.ply": splat_bytes(tmp_path, gaussians), "a.jpg": photo(1), "b.jpg": photo(2)}
    folder = upload({**files, "transforms.json": _transforms(["a.jpg", "b.jpg"])})
    validated = validate_upload(folder, settings)
    assert (validated.source, validated.images, validated.gaussians) == ("nerfstudio", 2, 40)
    capture = build_capture(validated.folder, tmp_path / "capture", settings, silent)
    assert capture.splat is not None and capture.report.splat == "desk.ply" and len(capture.points) == 0
    rows = load_splat(capture.splat)
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        np.testing.assert_array_equal(getattr(rows, name), getattr(gaussians, name))
    np.testing.assert_allclose(capture.views[0].posed.world_from_camera[:3, 3], [0, 0, 3])


def test_poses_move_into_the_world_that_nerfstudio_trained_in(upload, photo, settings, tmp_path: Path) -> None:
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    transform = np.concatenate([turn, [[1.0], [2.0], [3.0]]], axis=1)
    applied = np.array([[1.0, 0, 0, 5], [0, 0, 1, 0], [0, -1, 0, 0]])
    whole = transform @ np.concatenate([applied, [[0, 0, 0, 1]]])  # what nerfstudio writes, in the end
    files = {"desk.ply": splat_bytes(tmp_path), "a.jpg": photo(1)}
    folder = upload(
        {
            **files,
            "transforms.json": _transforms(["a.jpg"], applied_transform=applied.tolist(), applied_scale=0.5),
            "dataparser_transforms.json": json.dumps({"transform": whole.tolist(), "scale": 0.1}).encode(),
        }
    )
    capture = build_capture(validate_upload(folder, settings).folder, tmp_path / "capture", settings, silent)
    pose = capture.views[0].posed.world_from_camera
    np.testing.assert_allclose(pose[:3, 3], (turn @ [0, 0, 3] + [1, 2, 3]) * 0.2)
    np.testing.assert_allclose(pose[:3, :3], turn @ np.diag([1.0, -1, -1]), atol=1e-12)


@pytest.mark.parametrize(
    "frame",
    [
        b"[]",
        b"{}",
        b'{"transform": [[1,0,0,0],[0,1,0,0]], "scale": 1}',
        b'{"transform": 3, "scale": 1}',
        b'{"scale": "x"}',
    ]
    + [json.dumps({"transform": np.eye(4).tolist()[:3], "scale": scale}).encode() for scale in (0, -1, "no", None)]
    + [json.dumps({"transform": (2 * np.eye(4)).tolist()[:3], "scale": 1}).encode()],
)
def test_a_frame_that_is_none(frame: bytes, photo, tmp_path: Path, refuses) -> None:
    files = {"desk.ply": splat_bytes(tmp_path), "a.jpg": photo(1), "transforms.json": _transforms(["a.jpg"])}
    refuses({**files, "dataparser_transforms.json": frame}, InvalidInputError, "dataparser_transforms.json")


def test_points_alone_are_no_splat(tmp_path: Path, refuses) -> None:
    write_table(tmp_path / "own.ply", {name: np.zeros(3) for name in "xyz"})
    refuses({"points.ply": (tmp_path / "own.ply").read_bytes()}, InvalidInputError, "points.ply", "no splat")


def test_two_splats(tmp_path: Path, refuses) -> None:
    refuses({name: splat_bytes(tmp_path) for name in ("a.ply", "b/c.ply")}, InvalidInputError, "2 splats", "b/c.ply")


def test_more_gaussians_than_the_limit(tmp_path: Path, refuses) -> None:
    files, said = {"desk.ply": splat_bytes(tmp_path)}, ("desk.ply", "40 Gaussians", "MAX_SPLAT_GAUSSIANS")
    refuses(files, LimitExceededError, *said, max_splat_gaussians=39)


def test_a_splat_that_is_cut_off_is_refused_by_the_confined_process(upload, settings, refused, tmp_path: Path) -> None:
    folder = upload({"desk.ply": splat_bytes(tmp_path)[:-1]})
    with refused(InvalidInputError, "desk.ply", "bytes where"):
        validate_in_sandbox(folder, settings)


def test_rows_that_cannot_be_shown_are_said(upload, settings, tmp_path: Path) -> None:
    gaussians = make_gaussians(40, 4, 0)
    gaussians.means[11] = np.nan
    validated = validate_upload(upload({"desk.ply": splat_bytes(tmp_path, gaussians)}), settings)
    assert "row 11" in validated.warnings[0]
    manifest, _ = read_manifest(validated.folder)
    assert (manifest.splat, manifest.gaussians) == ("desk.ply", 40)
