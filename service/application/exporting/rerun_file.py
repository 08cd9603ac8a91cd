"""A scene as a recording for Rerun: the splat, boxes with names, cameras with their photos.

This module needs the optional package rerun-sdk, Rerun's own writer with its own types. Its type for Gaussians is
marked unstable: files are for viewers of the same release as the package.

Entities, all static, in the world frame of the version: `/splat` (GaussianSplats3D), `/things/ID` (Boxes3D),
`/cameras/NUMBER` (Transform3D, Pinhole), `/cameras/NUMBER/photo` (EncodedImage).
"""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.application.exporting.scene_recording import SceneRecording, described, thing_color, thing_facts
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.types import SH_C0, Gaussians, Scene
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import MissingPackageError
from fastsplat_contract.poses import F64, quaternion_of
from fastsplat_contract.thing_messages import SceneThing

_APPLICATION = "fastsplat"
_SH_COUNT = 15
_UPRIGHT_COSINE = 0.985
"""Of 10 degrees: a scene that stands more askew has no axis that is up."""
_UP = {
    (0, 1): rr.ViewCoordinates.RIGHT_HAND_X_UP,
    (0, -1): rr.ViewCoordinates.RIGHT_HAND_X_DOWN,
    (1, 1): rr.ViewCoordinates.RIGHT_HAND_Y_UP,
    (1, -1): rr.ViewCoordinates.RIGHT_HAND_Y_DOWN,
    (2, 1): rr.ViewCoordinates.RIGHT_HAND_Z_UP,
    (2, -1): rr.ViewCoordinates.RIGHT_HAND_Z_DOWN,
}
_SURFACE_ALPHA, _THING_ALPHA = 100, 255

rr.set_strict_mode(True)  # what is wrong is raised, where the package's default is to log it and to leave it out


def rerun_file(index: SceneIndex, gaussians: Gaussians, recording: SceneRecording, things: Sequence[int] = ()) -> bytes:
    """An .rrd file. Each call gives other bytes of the same content: Rerun numbers its chunks by the clock.

    Colors are the constant coefficients and the opacities, in 8 bits; higher coefficients are as trained. Properties of
    the recording: `scene`, as in the metadata of `foxglove_file`. Boxes have what is known of a thing as components of
    `thing`.

    Args:
        index: the scene.
        gaussians: those of its Gaussians that the file holds, in their order.
        recording: see `SceneRecording`.
        things: ids; empty: all.

    Raises:
        MissingPackageError: recording is switched off in this process (the variable RERUN).
    """
    scene = index.scene
    listed = [thing for thing in index.things.listed if not things or thing.id in things]
    stream = rr.RecordingStream(
        _APPLICATION, recording_id=f"{recording.scene_id}-{recording.version}", make_default=False
    )
    if not rr.is_enabled(stream):
        raise MissingPackageError(
            "Rerun's package records nothing here: the environment variable RERUN switches it off",
            field="format",
            hint="Unset RERUN where scenes are served.",
        )
    memory = stream.memory_recording()
    stream.send_recording_name(recording.name or recording.scene_id)
    stream.send_recording_start_time_nanos(recording.created_ns)
    stream.send_property("scene", rr.DynamicArchetype("scene", components=described(scene, recording, listed)))
    _log_up(stream, scene)
    stream.log("splat", _splats(gaussians), static=True)
    for thing in listed:
        if thing.box is not None:
            stream.log(f"things/{thing.id}", _box(thing), static=True)
            stream.log(f"things/{thing.id}", rr.DynamicArchetype("thing", components=thing_facts(thing)), static=True)
    for number, posed in enumerate(scene.cameras):
        _log_camera(stream, f"cameras/{number}", posed, recording.photos.get(number))
    return memory.drain_as_bytes()


def _log_up(stream: rr.RecordingStream, scene: Scene) -> None:
    """Which axis is up, where one is."""
    up = scene.up()
    if up is None:
        return
    axis = int(np.argmax(np.abs(up)))
    if abs(up[axis]) >= _UPRIGHT_COSINE:
        stream.log("/", _UP[axis, int(np.sign(up[axis]))], static=True)


def _splats(gaussians: Gaussians) -> rr.GaussianSplats3D:
    quats = gaussians.quats / np.linalg.norm(gaussians.quats, axis=1, keepdims=True)
    opacity = 1 / (1 + np.exp(-gaussians.logit_opacities.astype(np.float64)))
    colors = np.column_stack([0.5 + SH_C0 * gaussians.sh[:, 0].astype(np.float64), opacity])
    higher = np.zeros((len(gaussians), _SH_COUNT, 3), np.float32)
    higher[:, : gaussians.sh.shape[1] - 1] = gaussians.sh[:, 1:]
    return rr.GaussianSplats3D(
        centers=gaussians.means,
        scales=np.exp(gaussians.log_scales),
        quaternions=np.roll(quats, -1, axis=1),  # x y z w there
        colors=_bytes(colors),
        sh_coefficients=higher if gaussians.sh_degree else None,
        spherical_harmonics_degree=gaussians.sh_degree,
    )


def _bytes(colors: F64) -> NDArray[np.uint8]:
    """uint8 of numbers from 0 to 1; beyond that the nearest value stands."""
    return np.asarray(np.round(255 * colors.clip(0, 1)), np.uint8)


def _box(thing: SceneThing) -> rr.Boxes3D:
    assert thing.box is not None
    alpha = _SURFACE_ALPHA if thing.kind == "surface" else _THING_ALPHA
    return rr.Boxes3D(
        centers=[thing.box.center.position],
        half_sizes=[np.array(thing.box.size) / 2],
        quaternions=[rr.Quaternion(xyzw=thing.box.center.orientation)],
        colors=[(*_bytes(np.array(thing_color(thing.id))), alpha)],
        labels=[thing.name or f"thing {thing.id}"],
        show_labels=True,
    )


def _log_camera(stream: rr.RecordingStream, path: str, posed: PosedCamera, photo: bytes | None) -> None:
    """A camera with OpenCV axes; pixels as everywhere here, the middle of the first one is (0.5, 0.5)."""
    pose, camera = posed.world_from_camera, posed.camera
    if photo is not None:
        with Image.open(io.BytesIO(photo)) as opened:
            camera = camera.scaled_to(*opened.size)
    stream.log(
        path,
        rr.Transform3D(translation=pose[:3, 3], quaternion=rr.Quaternion(xyzw=quaternion_of(pose[:3, :3]))),
        rr.Pinhole(
            focal_length=(camera.fx, camera.fy),
            principal_point=(camera.cx, camera.cy),
            resolution=(camera.width, camera.height),
            camera_xyz=rr.ViewCoordinates.RDF,
        ),
        static=True,
    )
    if photo is not None:
        stream.log(f"{path}/photo", rr.EncodedImage(contents=photo, media_type="image/jpeg"), static=True)
