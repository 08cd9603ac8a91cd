"""Lengths in scenes whose places and sizes are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.measures.locating import locate
from fastsplat.service.query.measures.measuring import measure
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene_facts import SceneFacts
from fastsplat_contract.errors import FastSplatError, InvalidInputError, NotFoundError
from fastsplat_contract.geometry.camera import Camera
from fastsplat_contract.geometry.object_prompts import Pixel
from fastsplat_contract.geometry.places import KnownLength, KnownSize, ObjectSide, Place
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.messages.measurements import Measurement
from fastsplat_contract.messages.scenes import Edit
from tests.query.box_scenes import BoxShell, orbit, scene_of
from tests.query.conftest import DrawnEncoder

_SIZE = (0.4, 0.2, 0.3)
_LEFT = BoxShell("left", (-0.5, 0.0, 0.0), _SIZE, count=12_000)
_RIGHT = BoxShell("right", (0.5, 0.0, 0.0), _SIZE, count=12_000)
_HERE = Place(point=Vector3(-0.5, 0.0, 0.0))
_THERE = Place(point=Vector3(0.5, 0.0, 0.0))


@pytest.fixture(scope="module")
def index() -> SceneIndex:
    sharp = Camera(768, 576, 720.0, 720.0, 384.0, 288.0)
    cameras = [replace(posed, camera=sharp) for posed in orbit(8, 2.5, 1.8)]
    scene = replace(scene_of([_LEFT, _RIGHT], cameras), scale="ARBITRARY")
    return SceneIndex(scene, DrawnEncoder(), QuerySettings(backend="cpu"))


def _measured(index: SceneIndex, *places: Place) -> Measurement:
    return measure(index, places, "1")


def test_objects_are_measured_from_their_surfaces_and_from_their_middles(index: SceneIndex) -> None:
    answer = _measured(index, Place(object_id=1), Place(object_id=2))
    assert answer.distance is not None and answer.center_distance is not None
    assert answer.distance.value == pytest.approx(0.6, abs=0.03)
    assert answer.center_distance.value == pytest.approx(1.0, abs=0.02)
    assert [place.object_id for place in answer.places] == [1, 2]
    assert _measured(index, Place(object_id=2), Place(object_id=1)).distance == answer.distance


def test_points_are_exact(index: SceneIndex) -> None:
    answer = _measured(index, _HERE, _THERE)
    assert answer.distance == pytest.approx((1.0, 1.0, 1.0)) and answer.center_distance is None


@pytest.mark.parametrize("camera", [0, 2, 5])
def test_a_pixel_is_where_its_ray_meets_the_surface(index: SceneIndex, camera: int) -> None:
    posed = index.scene.cameras[camera]
    for center in (_LEFT.centre, _RIGHT.centre):
        target = np.add(center, (0.0, 0.0, _SIZE[2] / 2))  # the middle of the top
        pixel = Pixel(*posed.pixels(target).tolist())
        place = locate(index, Place(view=posed.name, pixel=pixel))
        error = np.linalg.norm(place.point - target)
        assert error < 0.03 and error <= place.plus_minus < 0.12, (error, place.plus_minus)
        assert place.object_id == (1 if center is _LEFT.centre else 2)
        free = locate(index, Place(camera=posed, pixel=pixel))
        assert (free.point == place.point).all()


def test_known_lengths_make_a_scene_metric(index: SceneIndex) -> None:
    scene = apply_edit(index, Edit("scale", known_lengths=(KnownLength(_HERE, _THERE, 0.25, 0.005),)))
    after = index.after(scene)
    answer, before = _measured(after, Place(object_id=1)), _measured(index, Place(object_id=1))
    assert answer.meters > before.meters and scene.scale == "METRIC" and scene.scaling is not None
    assert answer.box is not None and answer.distance is None
    assert [side.value for side in answer.sides] == pytest.approx(
        [0.25 * side.value for side in before.sides], rel=1e-3
    )
    for side, old in zip(answer.sides, before.sides, strict=True):  # what the scale is unsure of comes on top
        assert (side.high - side.low) / side.value > (old.high - old.low) / old.value
    assert scene.scaling.low == pytest.approx(0.25 * 0.98, rel=1e-2)
    # In meters now: another length, that says a little more, is combined with the first.
    first, second = (Place(point=Vector3(*(0.25 * value for value in place.point or ()))) for place in (_HERE, _THERE))
    more = apply_edit(after, Edit("scale", known_lengths=(KnownLength(first, second, 0.26, 0.005),)))
    assert more.scaling is not None and len(more.scaling.lengths) == 2
    assert more.scaling.meters_per_unit == pytest.approx(0.255, rel=2e-3)
    np.testing.assert_allclose(
        more.gaussians.means, more.scaling.meters_per_unit * index.scene.gaussians.means, rtol=1e-5, atol=1e-7
    )


def test_what_tags_leave_unsure_is_in_lengths_and_weighs_beside_known_ones(index: SceneIndex) -> None:
    facts = SceneFacts(scale_source="tags", scale_error_95=0.02)
    tagged = index.after(replace(index.scene, scale="METRIC", facts=facts))
    for side, plain in zip(
        _measured(tagged, Place(object_id=1)).sides, _measured(index, Place(object_id=1)).sides, strict=True
    ):
        half, exact = (side.high - side.low) / 2, (plain.high - plain.low) / 2
        assert half == pytest.approx(np.hypot(exact, 0.02 * side.value), rel=1e-3)
    # A length as sure as the tags, that says 2 % more: the truth is sought in the middle.
    both = apply_edit(tagged, Edit("scale", known_lengths=(KnownLength(_HERE, _THERE, 1.02, 0.02),)))
    assert both.scaling is not None and len(both.scaling.lengths) == 2
    assert both.scaling.meters_per_unit == pytest.approx(1.01, abs=1e-3)


@pytest.mark.parametrize(
    ("places", "error", "field"),
    [
        ((), InvalidInputError, "places"),
        ((_HERE,) * 3, InvalidInputError, "places"),
        ((Place(),), InvalidInputError, "places[0].pixel"),
        ((_HERE, Place(point=Vector3(0, 0, 0), object_id=1)), InvalidInputError, "places[1].object_id"),
        ((Place(pixel=Pixel(1.0, 1.0)),), InvalidInputError, "places[0].view"),
        ((Place(view="0.jpg", object_id=1),), InvalidInputError, "places[0].view"),
        ((Place(view="0.jpg", pixel=Pixel(768.0, 1.0)),), InvalidInputError, "places[0].pixel"),
        ((Place(view="0.jpg", pixel=Pixel(1.0, 1.0)),), NotFoundError, "places[0].pixel"),
        ((Place(view="none.jpg", pixel=Pixel(1.0, 1.0)),), NotFoundError, "places[0].view"),
        ((Place(object_id=9),), NotFoundError, None),
        ((Place(point=Vector3(float("nan"), 0, 0)),), InvalidInputError, "places[0].point"),
    ],
)
def test_a_place_that_is_none_is_refused(
    index: SceneIndex, places: tuple[Place, ...], error: type[FastSplatError], field: str | None
) -> None:
    with pytest.raises(error) as caught:
        _measured(index, *places)
    assert field is None or caught.value.field == field


@pytest.mark.parametrize(
    ("edit", "field"),
    [
        (Edit("scale"), "known_lengths"),
        (Edit("scale", object_ids=(1,), known_lengths=(KnownLength(_HERE, _THERE, 1.0),)), "label"),
        (Edit("scale", known_lengths=(KnownLength(_HERE, _HERE, 1.0),)), "known_lengths[0].second"),
        (
            Edit("scale", known_lengths=(KnownLength(_HERE, Place(object_id=1), 1.0),)),
            "known_lengths[0].second.object_id",
        ),
        (Edit("remove", object_ids=(1,), known_lengths=(KnownLength(_HERE, _THERE, 1.0),)), "known_lengths"),
    ],
)
def test_a_scale_that_is_none_is_refused(index: SceneIndex, edit: Edit, field: str) -> None:
    with pytest.raises(InvalidInputError) as caught:
        apply_edit(index, edit)
    assert caught.value.field == field


@pytest.mark.parametrize(("side", "true"), [("longest", 0.4), ("height", 0.3)])
def test_an_object_of_known_size_makes_the_scene_metric(index: SceneIndex, side: ObjectSide, true: float) -> None:
    """The world is two and a half times as large as the scene."""
    known = KnownSize(1, 2.5 * true, side=side)
    scaled = apply_edit(index, Edit("scale", known_sizes=(known,)))
    assert scaled.scale == "METRIC" and scaled.scaling is not None
    assert scaled.scaling.low <= 2.5 <= scaled.scaling.high
    # A box leaves out what lies at its ends: the interval says so, whatever the measurement at hand.
    assert scaled.scaling.high / scaled.scaling.low > 1.1
    length = KnownLength(_HERE, _THERE, 2.5)
    both = apply_edit(index, Edit("scale", known_lengths=(length,), known_sizes=(known,)))
    assert both.scaling is not None and len(both.scaling.lengths) == 2
    assert both.scaling.meters_per_unit == pytest.approx(2.5, rel=2e-3)  # the surer one decides


def test_sizes_of_nothing_are_refused(index: SceneIndex) -> None:
    with pytest.raises(NotFoundError) as caught:
        apply_edit(index, Edit("scale", known_sizes=(KnownSize(99, 1.0),)))
    assert "known_sizes[0]" in caught.value.field
    with pytest.raises(InvalidInputError):
        apply_edit(index, Edit("recolor", color=(0, 0, 0), object_ids=(1,), known_sizes=(KnownSize(1, 1.0),)))


@pytest.mark.parametrize(
    "places", [(Place(object_id=1),), (Place(object_id=1), _THERE), (Place(object_id=2), Place(object_id=1))]
)
def test_an_object_too_faint_to_be_seen_is_refused(index: SceneIndex, places: tuple[Place, ...]) -> None:
    gaussians = index.scene.gaussians
    logits = np.where(index.objects.owner == 1, np.float32(-12), gaussians.logit_opacities)
    faint = replace(index.objects.scene, gaussians=replace(gaussians, logit_opacities=logits))
    with pytest.raises(NotFoundError, match="too faint") as caught:
        _measured(index.after(faint), *places)
    assert caught.value.field == f"places[{places.index(Place(object_id=1))}].object_id"
