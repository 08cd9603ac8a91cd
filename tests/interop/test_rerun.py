"""Recordings for Rerun, as its own reader reads them."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fastsplat.service.application.exporting.rerun_file import rerun_file
from fastsplat.service.application.exporting.scene_exports import _of_things
from fastsplat.service.application.exporting.scene_recording import SceneRecording
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.types import SH_C0
from fastsplat_contract.errors import MissingPackageError
from tests.interop.rrd import Components, components_of, recording_of
from tests.interop.wall_views import HOSTILE, PHOTOS, START, seen_wall


def _index(tilt: float = 0.0) -> SceneIndex:
    """The wall of `seen_wall`; y is down, but for the tilt."""
    return seen_wall(lambda angle: Rotation.from_euler("zy", [tilt, angle]).as_matrix())


def _read(folder: Path, index: SceneIndex, things: Sequence[int] = (), name: str = "wall") -> Components:
    """The components of each entity."""
    recording = SceneRecording("an-id", "v7", name, START, b"", PHOTOS, 1)
    path = folder / "scene.rrd"
    path.write_bytes(rerun_file(index, _of_things(index, things), recording, things))
    assert recording_of(path) == ("fastsplat", "an-id-v7")
    return components_of(path)


@pytest.mark.parametrize("things", [(), (2,)])
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_the_splat_is_that_of_the_scene(tmp_path: Path, things: tuple[int, ...], degree: int) -> None:
    index = _index()
    rng = np.random.default_rng(2)
    sh = rng.normal(scale=0.3, size=(len(index.scene.gaussians), (degree + 1) ** 2, 3)).astype(np.float32)
    gaussians = dataclasses.replace(
        index.scene.gaussians, sh=sh, quats=rng.normal(size=(len(sh), 4)).astype(np.float32)
    )
    index = index.after(dataclasses.replace(index.scene, gaussians=gaussians))
    kept = _of_things(index, things)
    assert 0 < len(kept) <= len(gaussians) and (len(kept) == len(gaussians)) == (not things)
    splat = _read(tmp_path, index, things)["/splat"]
    np.testing.assert_array_equal(np.array(splat["GaussianSplats3D:centers"], np.float32), kept.means)
    np.testing.assert_array_equal(np.array(splat["GaussianSplats3D:scales"], np.float32), np.exp(kept.log_scales))
    turned = Rotation.from_quat(splat["GaussianSplats3D:quaternions"]).as_matrix()
    np.testing.assert_allclose(turned, Rotation.from_quat(kept.quats[:, [1, 2, 3, 0]]).as_matrix(), atol=1e-5)
    packed = np.array(splat["GaussianSplats3D:colors"], np.uint32)
    red, green, blue, alpha = (packed >> shift & 255 for shift in (24, 16, 8, 0))
    colors = np.column_stack([red, green, blue]) / 255
    np.testing.assert_allclose(colors, (0.5 + SH_C0 * kept.sh[:, 0]).clip(0, 1), atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(alpha / 255, 1 / (1 + np.exp(-kept.logit_opacities)), atol=0.5 / 255 + 1e-6)
    assert splat["GaussianSplats3D:spherical_harmonics_degree"] == [degree]
    if degree:
        higher = np.array(splat["GaussianSplats3D:sh_coefficients"], np.float32).reshape(len(kept), 15, 3)
        count = kept.sh.shape[1] - 1
        np.testing.assert_allclose(higher[:, :count], kept.sh[:, 1:], rtol=1e-3, atol=1e-4)
        assert not higher[:, count:].any()
    else:
        assert "GaussianSplats3D:sh_coefficients" not in splat


def test_each_thing_is_a_box_with_its_name(tmp_path: Path) -> None:
    index = _index()
    read = _read(tmp_path, index)
    assert len(index.things.listed) == 2
    for thing in index.things.listed:
        entity = read[f"/things/{thing.id}"]
        assert thing.box is not None
        np.testing.assert_allclose(entity["Boxes3D:centers"], [thing.box.center.position], rtol=1e-6)
        np.testing.assert_allclose(np.array(entity["Boxes3D:half_sizes"]) * 2, [thing.box.size], rtol=1e-6)
        np.testing.assert_allclose(entity["Boxes3D:quaternions"], [thing.box.center.orientation], atol=1e-6)
        assert entity["Boxes3D:labels"] == [thing.name] == entity["thing:name"]
        assert float(entity["thing:probability"][0]) == thing.probability
        assert int(entity["thing:gaussians"][0]) == thing.gaussian_count
    assert {path for path in _read(tmp_path, index, (2,)) if path.startswith("/things")} == {"/things/2"}


def test_cameras_see_what_the_scenes_cameras_see_and_have_their_photos(tmp_path: Path) -> None:
    index = _index()
    read = _read(tmp_path, index)
    for number, posed in enumerate(index.scene.cameras):
        entity = read[f"/cameras/{number}"]
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat(entity["Transform3D:quaternion"][0]).as_matrix()
        pose[:3, 3] = entity["Transform3D:translation"][0]
        np.testing.assert_allclose(pose, posed.world_from_camera, atol=1e-6)
        size = [32, 24] if number in PHOTOS else [posed.camera.width, posed.camera.height]
        camera = posed.camera.scaled_to(*size)
        intrinsics = np.array(entity["Pinhole:image_from_camera"][0]).reshape(3, 3).T  # columns first there
        np.testing.assert_allclose(
            intrinsics, [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], rtol=1e-6
        )
        assert entity["Pinhole:resolution"] == [size]
        assert entity["Pinhole:camera_xyz"] == [[3, 2, 5]]  # right, down, forward
    photos = {path: bytes(entity["EncodedImage:blob"][0]) for path, entity in read.items() if path.endswith("/photo")}
    assert photos == {f"/cameras/{number}/photo": photo for number, photo in PHOTOS.items()}


def test_what_is_up_is_said_where_an_axis_is(tmp_path: Path) -> None:
    assert _read(tmp_path, _index())["/"]["ViewCoordinates:xyz"] == [[3, 2, 5]]  # y is down
    assert "/" not in _read(tmp_path, _index(tilt=0.4))


def test_properties_say_what_the_scene_is_and_that_lengths_are_not_meters(tmp_path: Path) -> None:
    index = _index()
    arbitrary = index.after(dataclasses.replace(index.scene, scale="ARBITRARY"))
    about = _read(tmp_path, arbitrary, name=HOSTILE)["/__properties/scene"]
    assert about["scene:scene_id"] == ["an-id"] and about["scene:version"] == ["v7"]
    assert about["scene:name"] == [HOSTILE] and about["scene:unit"] == ["arbitrary"]
    assert "not meters" in about["scene:warning"][0] and json.loads(about["scene:photos_left_out"][0]) == 1
    info = _read(tmp_path, index)["/__properties"]
    assert "scene:warning" not in _read(tmp_path, index)["/__properties/scene"]
    assert info["RecordingInfo:name"] == ["wall"]


def test_a_process_where_rerun_is_switched_off_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("fastsplat.service.application.exporting.rerun_file.rr.is_enabled", lambda recording: False)
    with pytest.raises(MissingPackageError, match="RERUN"):
        _read(tmp_path, _index())
