"""JSON models to the service's types and back, nothing else. Names that agree are copied by pydantic."""

from __future__ import annotations

import base64
from collections.abc import Sequence

from fastsplat.api.cameras import WORLD, orientation_of, posed_camera, position_of, unit_quaternion
from fastsplat.api.rest import models
from fastsplat.service.calls import types
from fastsplat.service.common.camera import Camera, PosedCamera


def camera_in(camera: models.PosedCamera, field: str) -> PosedCamera:
    """A viewpoint as the service takes it; `field` names it in errors."""
    return posed_camera(
        Camera(**vars(camera.intrinsics)),
        _xyz(camera.position),
        _xyzw(camera.orientation),
        convention=camera.convention,
        frame_id=camera.frame_id,
        field=field,
    )


def query_in(scene_id: str, query: models.QueryIn) -> types.QueryRequest:
    """Questions as the service takes them."""
    return types.QueryRequest(
        scene_id,
        tuple(query.texts),
        tuple(camera_in(camera, f"cameras[{index}]") for index, camera in enumerate(query.cameras)),
        tuple(query.views),
        frozenset(query.outputs),
        version=query.version,
        negatives=tuple(query.negatives),
        templates=tuple(query.templates),
        coverage=query.coverage,
        max_matches=query.max_matches,
        mask2d_encoding=query.mask2d_encoding,
        mask3d_encoding=query.mask3d_encoding,
    )


def edits_in(edits: Sequence[models.Edit]) -> tuple[types.Edit, ...]:
    """Edits as the service takes them."""
    return tuple(_edit_in(edit, f"edits[{number}]") for number, edit in enumerate(edits))


def camera_out(posed: PosedCamera) -> models.PosedCamera:
    """A scene's view as JSON."""
    return models.PosedCamera(
        intrinsics=models.Intrinsics(**vars(posed.camera)),
        position=_vector(position_of(posed)),
        orientation=_quaternion(orientation_of(posed)),
        convention="OPENCV",
        frame_id=WORLD,
        name=posed.name,
    )


def operation_out(operation: types.Operation) -> models.Operation:
    """A job as JSON."""
    return models.Operation.model_validate(operation)


def summary_out(scene: types.SceneInfo) -> models.SceneSummary:
    """A scene as a list shows it."""
    return models.SceneSummary.model_validate(scene)


def scene_out(scene: types.SceneInfo) -> models.Scene:
    """A scene in full."""
    return models.Scene(
        **vars(summary_out(scene)),
        camera_count=scene.camera_count,
        dictionary=[models.DictionaryEntry.model_validate(row) for row in scene.dictionary],
        cameras=[camera_out(camera) for camera in scene.cameras],
        quality=dict(scene.quality),
    )


def version_out(version: types.SceneVersion) -> models.SceneVersion:
    """A version as JSON."""
    return models.SceneVersion(
        scene_id=version.scene_id,
        version=version.version,
        parent=version.parent,
        created_at=version.created_at,
        gaussians=version.gaussians,
        current=version.current,
        edits=[
            models.Edit(
                action=edit.action,
                label=edit.label,
                object_id=edit.object_id,
                colour=None if edit.colour is None else models.Colour(**dict(zip("rgb", edit.colour, strict=True))),
                transform=None if edit.transform is None else _pose(edit.transform),
            )
            for edit in version.edits
        ],
    )


def object_out(thing: types.SceneObject) -> models.SceneObject:
    """A thing as JSON."""
    return models.SceneObject(
        id=thing.id,
        label_id=thing.label_id,
        label=thing.label,
        score=thing.score,
        centroid=_vector(thing.centroid),
        box=models.Box(center=_pose(thing.box.center), size=_vector(thing.box.size)),
        gaussian_count=thing.gaussian_count,
        metres=thing.metres,
        best_views=list(thing.best_views),
    )


def answer_out(result: types.QueryAnswer, outputs: frozenset[types.Output]) -> models.Answer:
    """One answer as JSON; scores as they are."""
    answer = result.answer
    return models.Answer(
        scene_id=result.scene_id,
        version=result.version,
        text=answer.text,
        verdict=answer.verdict,
        explanation=answer.explanation,
        probability=answer.probability,
        label_set=list(answer.label_set),
        coverage=answer.coverage,
        decided_by=answer.decided_by,
        threshold=answer.threshold,
        match_count=result.match_count,
        gaussians=result.gaussians,
        matches=[models.Match.model_validate(match) for match in answer.matches],
        masks=[_mask_out(mask) for mask in result.masks],
        mask3d=_base64(result.mask3d) if "mask3d" in outputs else None,
        objects=[object_out(thing) for thing in result.objects] if "objects" in outputs else None,
    )


def _mask_out(mask: types.ViewMask) -> models.ViewMask:
    rle = mask.rle
    return models.ViewMask(
        view=mask.view,
        camera_index=mask.camera_index,
        segmentation=rle and models.Segmentation(size=(rle.height, rle.width), counts=rle.counts),
        png=_base64(mask.png) if mask.png else None,
        area=mask.area,
    )


def _edit_in(edit: models.Edit, field: str) -> types.Edit:
    colour, pose = edit.colour, edit.transform
    turned = pose and unit_quaternion(_xyzw(pose.orientation), field=f"{field}.transform.orientation")
    return types.Edit(
        edit.action,
        edit.label,
        edit.object_id,
        None if colour is None else (colour.r, colour.g, colour.b),
        types.Pose(_xyz(pose.position), turned) if pose and turned else None,
    )


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _pose(pose: types.Pose) -> models.Pose:
    return models.Pose(position=_vector(pose.position), orientation=_quaternion(pose.orientation))


def _xyz(vector: models.Vector3) -> types.Vector:
    return vector.x, vector.y, vector.z


def _xyzw(rotation: models.Quaternion) -> types.Quaternion:
    return rotation.x, rotation.y, rotation.z, rotation.w


def _vector(values: types.Vector) -> models.Vector3:
    x, y, z = values
    return models.Vector3(x=x, y=y, z=z)


def _quaternion(values: types.Quaternion) -> models.Quaternion:
    x, y, z, w = values
    return models.Quaternion(x=x, y=y, z=z, w=w)
