"""What is stored with a scene comes back as the contract's types."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fastsplat.service.application.jobs.stored import operation_of, scene_of
from fastsplat.service.scene.artefact.alignment import Alignment, alignment_to_json
from fastsplat.service.store.rows.codec import camera_to_json, options_from_json
from fastsplat.service.store.rows.records import OperationRecord
from fastsplat.workers.job.protocol import Job, read_job
from fastsplat_client.assistant.tools import up_of
from fastsplat_contract.codec.json_codec import from_json, to_json
from fastsplat_contract.codec.proto_codec import from_proto, to_proto
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.jobs.operations import SceneOptions
from fastsplat_contract.messages.scenes import Scene, SceneVertical
from tests.query.box_scenes import orbit


def _options_of(record: OperationRecord) -> SceneOptions:
    return options_from_json({**record.options, "priority": record.priority})


_OPTIONS = SceneOptions(("cup", "book"), 9.5, 50, "draft", priority=7, lens="fisheye", nadir_deg=20.0)


@pytest.mark.parametrize("options", [_OPTIONS, replace(_OPTIONS, preset=None, tolerance_db=0.25)])
def test_every_option_reaches_the_worker_and_its_trainer(service, settings, tmp_path, options):
    with service.new_upload() as upload:
        upload.write("a.jpg", [b"picture"])
        operation = service.create_scene(upload, "desk", "", options)
    record = service._store.scenes.operation(operation.id)
    assert _options_of(record) == options
    job = Job(operation.id, 1, tmp_path, tmp_path, _options_of(record), settings)
    assert read_job(job.to_line("real"))[0].options == options


def test_a_scene_says_what_is_up_and_what_measured_it(service, post):
    record = service._store.scenes.scene(post().id)
    quality = {
        "vertical_source": "planes",
        "vertical_deviation_deg": 0.4,
        "scale_source": "gps",
        "scale_error_95": 0.06,
    }
    scene = scene_of(replace(record, scale="METRIC", quality=quality))
    assert scene.vertical == SceneVertical("planes", 0.4, Vector3(0.0, 0.0, 1.0))
    assert scene.scaling is not None and scene.scaling.source == "gps"
    assert scene.scaling.low == pytest.approx(1 / scene.scaling.high) and 1.05 < scene.scaling.high < 1.07
    assert from_proto(Scene, to_proto(scene)) == from_json(Scene, to_json(scene)) == scene, "on every face"
    assert up_of(scene) == "+z, by planes, within 0.8 degrees"
    assert scene_of(record).vertical is None and scene_of(record).scaling is None
    lying = Alignment("map", ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)), (0.0, 0.0, 0.0))
    aligned = scene_of(replace(record, quality=quality, alignment=alignment_to_json(lying)))
    assert aligned.vertical == SceneVertical("planes", 0.4, Vector3(0.0, -1.0, 0.0))
    assert up_of(aligned) == "(0.000, -1.000, 0.000), by planes, within 0.8 degrees"
    cameras = [camera_to_json(posed) for posed in orbit()]
    vertical = scene_of(replace(record, cameras=cameras, alignment=alignment_to_json(lying))).vertical
    assert vertical is not None and vertical.source == "horizon", "by the cameras, where nothing else is"
    assert tuple(vertical.up) == pytest.approx((0, -1, 0), abs=1e-9)


def test_a_metric_that_is_no_number_is_left_out(service, post):
    record = service._store.scenes.operation(post().operation_id)
    metrics = {"psnr": float("inf"), "loss": float("nan"), "step": 3.0}
    stage = {"stage": "training", "fraction": 0.5, "message": "", "seconds": 1.0, "metrics": metrics}
    (stage_progress,) = operation_of(type(record)(**{**vars(record), "stages": [stage]})).stages
    assert stage_progress.metrics == {"step": 3.0}
