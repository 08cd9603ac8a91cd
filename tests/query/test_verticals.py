"""Which way is up: one answer for all that ask, by the best that is known, in every frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fastsplat.service.application.exporting.geometry_files import about
from fastsplat.service.application.exporting.scene_recording import SceneRecording, described
from fastsplat.service.query.edits.aligning import align_scene
from fastsplat.service.query.edits.scale_edits import scale_scene
from fastsplat.service.query.measures.locating import locate
from fastsplat.service.query.measures.next_viewpoints import next_photos
from fastsplat.service.query.measures.object_detections import detections_of
from fastsplat.service.query.measures.object_extents import object_extents
from fastsplat.service.query.surfaces.occupancy import check_map_frame
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.scene.artefact.scene_facts import SceneFacts, split_quality
from fastsplat.service.scene.artefact.upright import up_of, vertical_of
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.places import Alignment, KnownLength, KnownSize, Place
from fastsplat_contract.geometry.poses import Box, Vector3, pose_of, rigid, vector3
from fastsplat_contract.messages.scenes import Edit, SceneVertical
from tests.query.box_scenes import BoxShell, look, orbit, scene_of
from tests.query.box_scenes import rigid as any_motion
from tests.query.conftest import index_of

_MUG = BoxShell("mug", (0.0, 0.0, 0.1), (0.06, 0.08, 0.2))
_TRAY = BoxShell("tray", (0.0, 0.0, -0.01), (0.6, 0.4, 0.02), count=900)
_RECORDED = {"vertical_source": "metadata", "vertical_deviation_deg": 0.5}
_TILTED = np.eye(4)
_TILTED[:3, :3] = Rotation.from_euler("x", 20, degrees=True).as_matrix()


def _moved(cameras: Sequence[PosedCamera], motion: np.ndarray) -> list[PosedCamera]:
    return [replace(posed, world_from_camera=motion @ posed.world_from_camera) for posed in cameras]


_CAMERAS = {"two cameras": orbit(2), "tilted cameras": _moved(orbit(8), _TILTED), "none": []}


def _scene(cameras: Sequence[PosedCamera], **quality: object) -> Scene:
    return replace(scene_of([_MUG, _TRAY], cameras), facts=split_quality(_RECORDED | quality)[0])


def _aligned(scene: Scene) -> Scene:
    motion = any_motion(11)
    transform = pose_of(motion)
    return align_scene(index_of(scene), Edit("align", alignment=Alignment("map", transform)))


def _scaled(scene: Scene) -> Scene:
    index = index_of(_aligned(scene))
    ends = [locate(index, Place(point=vector3(index.scene.gaussians.means[row]))).point for row in (0, 250)]
    length = KnownLength(*(Place(point=vector3(end)) for end in ends), meters=0.7)
    return scale_scene(index, Edit("scale", known_lengths=(length,)))


_EDITS: dict[str, Callable[[Scene], Scene]] = {"trained": lambda scene: scene, "aligned": _aligned, "scaled": _scaled}


@pytest.mark.parametrize("edit", _EDITS)
@pytest.mark.parametrize("cameras", _CAMERAS)
def test_all_that_ask_get_the_recorded_vertical(cameras: str, edit: str) -> None:
    scene = _EDITS[edit](_scene(_CAMERAS[cameras]))
    index = index_of(scene)
    up = np.eye(3)[2] if scene.alignment is None else np.array(scene.alignment.rotation)[:, 2]

    def upright(box: Box | None) -> None:
        assert box is not None
        np.testing.assert_allclose(rigid(box.center.orientation, box.center.position)[:3, 2], up, atol=1e-6)

    np.testing.assert_allclose(index.objects.measures.up, up, atol=1e-12)
    np.testing.assert_allclose(about(index, "", ()).up, up, atol=1e-12)
    recording = SceneRecording("a", "1", "", 0, b"", {})
    assert described(scene, recording, ())["up"] == str(list(up.tolist()))
    listed = index.objects.listed
    detections = detections_of(index, listed, "1")
    np.testing.assert_allclose(detections.up, up, atol=1e-12)
    assert detections.detections[0].support is not None and detections.detections[0].support.relation == "on"
    (on,) = index.ask(["mug on the tray"])
    assert on.phrase is not None and on.phrase.refusal is None
    for obj in listed:
        upright(obj.box)
    extents = object_extents(index, 1)
    assert extents is not None
    upright(extents.box)
    for photo in next_photos(index):  # their pictures are upright
        assert abs(photo.camera.world_from_camera[:3, 0] @ up) < 1e-9
    scale_scene(index, Edit("scale", known_sizes=(KnownSize(1, 0.2, side="height"),)))
    if scene.alignment is None:
        check_map_frame(scene)
    else:
        with pytest.raises(InvalidInputError, match="degrees away"):
            check_map_frame(scene)


def test_without_a_record_level_cameras_tell_and_say_how_sure_they_are() -> None:
    for motion in (np.eye(4), any_motion(3)):
        vertical = vertical_of(SceneFacts(), None, _moved(orbit(), motion))
        assert vertical is not None and (vertical.source, vertical.deviation_deg) == ("horizon", 0.2)
        np.testing.assert_allclose(vertical.up, motion[:3, 2], atol=1e-9)
    assert vertical_of(SceneFacts(), None, orbit(2)) is None and vertical_of(SceneFacts(), None, ()) is None
    beside = [look((x, -1, 0), (x, 0, 0), "") for x in (0, 1, 2, 3)]
    assert vertical_of(SceneFacts(), None, beside) is None  # any tilt fits


def test_a_guess_of_the_vertical_is_shown_and_not_used() -> None:
    guess = SceneVertical("cameras", 15.0, Vector3(0.0, 0.0, 1.0))
    figures = {"vertical_source": "cameras", "vertical_deviation_deg": 15.0}
    assert vertical_of(split_quality(figures)[0], None, orbit(2)) == guess
    assert up_of(guess) is None and up_of(None) is None
    assert index_of(_scene(orbit(2), **figures)).objects.measures.up is None


@pytest.mark.parametrize(
    "damaged", [{"vertical_source": "sonar"}, {"vertical_deviation_deg": "half"}, {"vertical_deviation_deg": np.nan}]
)
def test_a_record_that_says_nothing_is_none(damaged: dict[str, object]) -> None:
    stored = _RECORDED | damaged | {"left_out": ["quality.psnr"], "draft": 7, "psnr": 30.0}
    facts, rest = split_quality(stored)
    assert sorted(map(str, facts.with_quality(rest).items())) == sorted(map(str, stored.items()))
    assert (facts.left_out, facts.draft, rest["left_out"], rest["draft"]) == (None, None, ["quality.psnr"], 7)
    vertical = vertical_of(facts, None, orbit())
    assert vertical is not None and vertical.source == "horizon"
