"""A splat of another tool, posted to a service with a real worker: a scene whose masks fit the user's own file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.service import open_service
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.formats.ply import read_ply, write_ply
from fastsplat.service.settings import Settings
from fastsplat_contract.jobs.operations import SceneOptions
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.photos.pictures import PictureRequest
from tests.instances.made_room import CAMERA, NAMES, Room, make_room
from tests.workers.deployment import post_folder, real_worker, wait_over

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture
def settings(tmp_path: Path, models_dir: Path) -> Settings:
    return Settings(data_dir=tmp_path / "data", models=models_dir)


@pytest.fixture
def worker(settings: Settings) -> Iterator[None]:
    """A worker that renders few pictures around a splat."""
    with real_worker(settings, SPLAT_IMPORT=json.dumps({"pictures": 3})):
        yield


def _shuffled(room: Room) -> tuple[Gaussians, np.ndarray]:
    """The room's splat as another tool might order it, one row of it not finite; and the owner of each row."""
    order = np.random.default_rng(1).permutation(len(room.gaussians))
    rows = {name: array[order] for name, array in vars(room.gaussians).items()}
    rows["means"] = rows["means"].copy()
    rows["means"][17] = np.nan
    return Gaussians(**rows), room.owner[order]


def _posed_photos(room: Room, folder: Path) -> None:
    """The room's photos, their poses as nerfstudio writes them, and what each pixel shows."""
    frames = []
    (folder / "masks").mkdir()
    for view, label_map in zip(room.capture.views, room.maps, strict=True):
        mask = f"masks/{view.posed.name}"
        Image.fromarray(label_map.astype(np.uint8)).save(folder / mask)
        pose = view.posed.world_from_camera @ _OPENGL_FROM_OPENCV
        frames.append({"file_path": view.posed.name, "mask_path": mask, "transform_matrix": pose.tolist()})
    numbers = {"fl_x": CAMERA.fx, "fl_y": CAMERA.fy, "cx": CAMERA.cx, "cy": CAMERA.cy, "w": CAMERA.width}
    labels = {name: number for number, name in enumerate(NAMES, start=1)}
    document = {**numbers, "h": CAMERA.height, "labels": labels, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(document))


@pytest.mark.usefixtures("worker")
def test_masks_of_an_imported_splat_are_rows_of_the_users_file(settings: Settings, tmp_path: Path) -> None:
    posed, alone = tmp_path / "posed", tmp_path / "alone"
    posed.mkdir()
    alone.mkdir()
    room = make_room(posed, views=6)
    splat, owner = _shuffled(room)
    _posed_photos(room, posed)
    for folder in (posed, alone):
        write_ply(splat, folder / "own.ply")
    with open_service(settings) as service:
        with_photos = post_folder(service, posed, SceneOptions())
        without = post_folder(service, alone, SceneOptions(up="z"))
        assert (ended := wait_over(service, with_photos)).state == "SUCCEEDED", ended.error

        info = service.get_scene(with_photos.scene_id)
        assert info.gaussians == len(splat) and info.quality["splat"] == "own.ply" and info.quality["psnr"] > 20
        assert any("row 17" in warning for warning in info.quality["warnings"])
        finite = np.arange(len(splat)) != 17
        exported = read_ply(service.answers.scene_ply(info.id)[0])
        for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
            np.testing.assert_array_equal(getattr(exported, name)[finite], getattr(splat, name)[finite])

        view = info.cameras[0].name
        outputs = frozenset({"mask2d", "mask3d"})
        request = QueryRequest(info.id, ("red ball",), views=(view,), outputs=outputs, mask3d_encoding="indices")
        (answer,) = service.answers.query(request).answers
        assert answer.outcome == "here" and answer.masks[0].area > 0 and answer.mask3d is not None
        rows = np.frombuffer(answer.mask3d, "<u4")
        assert len(rows) > 20 and 17 not in rows and (owner[rows] == 1).mean() > 0.9
        (answer,) = service.answers.query(replace(request, mask3d_encoding="ply")).answers
        (tmp_path / "ball.ply").write_bytes(answer.mask3d or b"")
        np.testing.assert_array_equal(read_ply(tmp_path / "ball.ply").means, splat.means[rows])
        picture = service.answers.picture(PictureRequest(info.id, "overlay", "red ball", view=view))
        assert picture.startswith(b"\x89PNG")
        assert [photo.view for photo in service.photos.all(info.id).photos] == [posed.name for posed in info.cameras]

        assert (ended := wait_over(service, without)).state == "SUCCEEDED", ended.error
        rendered = service.get_scene(without.scene_id)
        assert service.photos.all(rendered.id).photos == ()  # pictures that were rendered are no photos
        assert (rendered.gaussians, rendered.quality["source"], len(rendered.cameras)) == (len(splat), "splat", 3)
        np.testing.assert_array_equal(
            read_ply(service.answers.scene_ply(rendered.id)[0]).means[finite], splat.means[finite]
        )


@pytest.mark.usefixtures("worker")
def test_photos_of_another_world_end_as_a_failure_that_says_what_to_do(settings: Settings, tmp_path: Path) -> None:
    room = make_room(tmp_path, views=4)
    moved = replace(room.gaussians, means=room.gaussians.means + np.float32(5))
    folder = tmp_path / "upload"
    folder.mkdir()
    _posed_photos(room, folder)
    for view in room.capture.views:
        (tmp_path / view.posed.name).rename(folder / view.posed.name)
    write_ply(moved, folder / "own.ply")
    with open_service(settings) as service:
        ended = wait_over(service, post_folder(service, folder, SceneOptions()))
    assert ended.state == "FAILED" and ended.error is not None
    assert (ended.error.stage, ended.error.kind) == ("training", "INVALID_ARGUMENT")
    assert ended.error.details["field"] == "poses" and "dataparser_transforms" in ended.error.details["hint"]
