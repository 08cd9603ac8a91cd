"""JSON models to the service's types and back, nothing else."""

from __future__ import annotations

import base64

from api.cameras import WORLD, orientation_of, posed_camera, position_of
from api.rest import models
from service.calls import types
from service.common.camera import Camera, PosedCamera

_FINAL = ("SUCCEEDED", "FAILED", "CANCELLED")


def camera_in(camera: models.PosedCamera, field: str) -> PosedCamera:
    """A viewpoint as the service takes it; `field` names it in errors."""
    intrinsics, position, orientation = camera.intrinsics, camera.position, camera.orientation
    return posed_camera(
        Camera(intrinsics.width, intrinsics.height, intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy),
        (position.x, position.y, position.z),
        (orientation.x, orientation.y, orientation.z, orientation.w),
        convention=camera.convention,
        frame_id=camera.frame_id,
        field=field,
    )


def query_in(scene_id: str, query: models.QueryIn) -> types.QueryRequest:
    """Questions as the service takes them."""
    cameras = tuple(camera_in(camera, f"cameras[{index}]") for index, camera in enumerate(query.cameras))
    return types.QueryRequest(scene_id, tuple(query.texts), cameras, tuple(query.views), frozenset(query.outputs))


def camera_out(posed: PosedCamera) -> models.PosedCamera:
    """A scene's view as JSON."""
    x, y, z = position_of(posed)
    qx, qy, qz, qw = orientation_of(posed)
    camera = posed.camera
    return models.PosedCamera(
        intrinsics=models.Intrinsics(
            width=camera.width, height=camera.height, fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy
        ),
        position=models.Vector3(x=x, y=y, z=z),
        orientation=models.Quaternion(x=qx, y=qy, z=qz, w=qw),
        convention="OPENCV",
        frame_id=WORLD,
        name=posed.name,
    )


def operation_out(operation: types.Operation) -> models.Operation:
    """A job as JSON."""
    error = operation.error
    return models.Operation(
        id=operation.id,
        scene_id=operation.scene_id,
        state=operation.state,
        done=operation.state in _FINAL,
        created_at=operation.created_at,
        updated_at=operation.updated_at,
        stages=[
            models.StageProgress(
                stage=stage.stage,
                fraction=stage.fraction,
                message=stage.message,
                seconds=stage.seconds,
                metrics=dict(stage.metrics),
            )
            for stage in operation.stages
        ],
        error=None
        if error is None
        else models.OperationError(
            kind=error.kind,
            reason=error.reason,
            message=error.message,
            stage=error.stage,
            details=dict(error.details),
        ),
    )


def summary_out(scene: types.SceneInfo) -> models.SceneSummary:
    """A scene as a list shows it."""
    return models.SceneSummary(
        id=scene.id,
        name=scene.name,
        state=scene.state,
        operation_id=scene.operation_id,
        created_at=scene.created_at,
        gaussians=scene.gaussians,
        scale=scene.scale,
    )


def scene_out(scene: types.SceneInfo) -> models.Scene:
    """A scene in full."""
    return models.Scene(
        **summary_out(scene).model_dump(),
        dictionary=[
            models.DictionaryEntry(
                label_id=row.label_id,
                label=row.label,
                aliases=list(row.aliases),
                pixels=row.pixels,
                views=row.views,
                gaussian_count=row.gaussian_count,
            )
            for row in scene.dictionary
        ],
        cameras=[camera_out(camera) for camera in scene.cameras],
        quality=dict(scene.quality),
    )


def answer_out(result: types.QueryAnswer, *, with_mask3d: bool) -> models.Answer:
    """One answer as JSON; scores as they are."""
    answer = result.answer
    return models.Answer(
        scene_id=result.scene_id,
        text=answer.text,
        verdict=answer.verdict,
        explanation=answer.explanation,
        matches=[
            models.Match(
                label_id=match.label_id,
                label=match.label,
                relevancy=match.relevancy,
                similarity=match.similarity,
                nearest_negative=match.nearest_negative,
                gaussian_count=match.gaussian_count,
                relevant=match.relevant,
            )
            for match in answer.matches
        ],
        masks=[_mask_out(mask) for mask in result.masks],
        mask3d=base64.b64encode(result.mask3d).decode("ascii") if with_mask3d else None,
    )


def _mask_out(mask: types.ViewMask) -> models.ViewMask:
    rle = mask.rle
    return models.ViewMask(
        view=mask.view,
        camera_index=mask.camera_index,
        segmentation=models.Segmentation(size=(rle.height, rle.width), counts=rle.counts),
        area=mask.pixels,
    )
