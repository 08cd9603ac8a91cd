"""REST = gRPC = in process."""

from __future__ import annotations

import base64
import io
import random
from typing import Any

import numpy as np
import pytest
from PIL import Image

from api.grpc.translate import camera_out
from api.rest.translate import camera_out as rest_camera_out
from fastsplat.v1 import fastsplat_pb2 as pb
from fastsplat_client.messages import joined
from service.calls.service import SceneService
from service.calls.types import QueryAnswer, QueryRequest
from service.common.camera import PosedCamera
from tests.api.made_scene import KINDRED, LABELS, STRANGERS, turned
from tests.api.served import Faces

_VIEWS = ("front.png", "photos/left side & ü.png", "a/b/right.png")
_WORDS = (*LABELS, *(word for words in KINDRED.values() for word in words), *STRANGERS)
_AWAY = PosedCamera(turned(0).camera, np.diag([-1.0, 1.0, -1.0, 1.0]))


def _questions(scene_id: str, count: int) -> list[QueryRequest]:
    """Texts, outputs, free poses (one looks away from everything) and views, drawn by a fixed seed."""
    rng = random.Random(11)
    cameras = [*(turned(angle) for angle in (-0.5, -0.2, 0.1, 0.4)), _AWAY]
    requests = []
    for number in range(count):
        drawn = frozenset(rng.sample(["mask2d", "mask3d"], rng.randrange(3)) if number % 8 == 0 else [])
        texts = tuple(rng.choices(_WORDS, k=rng.choice([1, 1, 1, 2, 3])))
        texts = tuple(rng.choice([text, text.upper(), f" {text} ", f"{text}s"]) for text in texts)
        posed = "mask2d" in drawn
        requests.append(
            QueryRequest(
                scene_id,
                tuple(text if text.strip().casefold() in _WORDS else text.strip() for text in texts),
                cameras=tuple(rng.sample(cameras, rng.randrange(2))) if posed else (),
                views=tuple(rng.sample(_VIEWS, 1)) if posed else (),
                outputs=drawn,
            )
        )
    return requests


def _plain(answers: tuple[QueryAnswer, ...]) -> list[dict[str, Any]]:
    return [
        {
            "scene_id": result.scene_id,
            "text": result.answer.text,
            "verdict": result.answer.verdict,
            "explanation": result.answer.explanation,
            "matches": [match._asdict() for match in result.answer.matches],
            "masks": [(m.view, m.camera_index, m.rle.height, m.rle.width, m.rle.counts, m.area) for m in result.masks],
            "mask3d": result.mask3d,
        }
        for result in answers
    ]


def _over_rest(faces: Faces, query: QueryRequest) -> list[dict[str, Any]]:
    if query.outputs:
        body = {
            "texts": query.texts,
            "cameras": [rest_camera_out(camera).model_dump() for camera in query.cameras],
            "views": query.views,
            "outputs": sorted(query.outputs),
        }
        response = faces.rest.post(f"/v1/scenes/{query.scene_id}:query", json=body)
    else:
        response = faces.rest.get("/query", params={"text": list(query.texts), "scene": query.scene_id})
    assert response.status_code == 200, response.text
    answers = response.json()["answers"]
    for answer in answers:
        answer["masks"] = [
            (m["view"], m["camera_index"], *m["segmentation"]["size"], m["segmentation"]["counts"], m["area"])
            for m in answer["masks"]
        ]
        assert (answer["mask3d"] is not None) == ("mask3d" in query.outputs)
        answer["mask3d"] = base64.b64decode(answer["mask3d"] or "")
    return answers


def _over_grpc(faces: Faces, query: QueryRequest) -> list[dict[str, Any]]:
    outputs = {"mask2d": pb.OUTPUT_MASK2D, "mask3d": pb.OUTPUT_MASK3D}
    request = pb.QueryRequest(
        scene_id=query.scene_id,
        texts=query.texts,
        cameras=[camera_out(camera) for camera in query.cameras],
        views=query.views,
        outputs=[outputs[name] for name in query.outputs],
    )
    fields = (
        "label_id",
        "label",
        "relevancy",
        "similarity",
        "nearest_negative",
        "gaussian_count",
        "relevant",
        "probability",
    )
    return [
        {
            "scene_id": whole.answer.scene_id,
            "text": whole.answer.text,
            "verdict": pb.Verdict.Name(whole.answer.verdict).removeprefix("VERDICT_").lower(),
            "explanation": whole.answer.explanation,
            "matches": [
                {
                    name: getattr(match, name) if name != "probability" or match.HasField(name) else None
                    for name in fields
                }
                for match in whole.answer.matches
            ],
            "masks": [
                (m.view, m.camera_index, m.segmentation.height, m.segmentation.width, m.segmentation.counts, m.area)
                for m in whole.masks
            ],
            "mask3d": whole.mask3d,
        }
        for whole in joined(faces.rpc.Query(request))
    ]


def _assert_same(one: list[dict[str, Any]], other: list[dict[str, Any]]) -> None:
    assert len(one) == len(other)
    for left, right in zip(one, other, strict=True):
        for scores in (left["matches"], right["matches"]):
            assert scores
        for mine, theirs in zip(left["matches"], right["matches"], strict=True):
            for name in ("relevancy", "similarity"):
                assert mine.pop(name) == pytest.approx(theirs.pop(name), abs=1e-6)
        assert left == right


def test_200_questions_get_the_same_answer_from_both_faces_and_in_process(
    faces: Faces, service: SceneService, scene_id: str
) -> None:
    verdicts: set[str] = set()
    masked = covered = 0
    for query in _questions(scene_id, 200):
        truth = service.query(query)
        verdicts |= {result.answer.verdict for result in truth}
        masked += sum(len(result.masks) for result in truth)
        covered += sum(mask.area > 0 for result in truth for mask in result.masks)
        _assert_same(_over_rest(faces, query), _plain(truth))
        _assert_same(_over_grpc(faces, query), _plain(truth))
    assert verdicts == {"exact", "related", "absent"}  # the questions are varied
    assert masked > covered > 5


def test_no_scene_means_all_ready_scenes(faces: Faces, service: SceneService, scene_id: str) -> None:
    truth = service.query(QueryRequest("", ("mug", "moon")))
    assert {result.scene_id for result in truth} >= {scene_id}
    everywhere = QueryRequest("", ("mug", "moon"))
    _assert_same(_over_rest(faces, everywhere), _plain(truth))
    _assert_same(_over_grpc(faces, everywhere), _plain(truth))


def test_a_pose_that_sees_nothing_gets_an_empty_mask(faces: Faces, scene_id: str) -> None:
    query = QueryRequest(scene_id, ("mug",), cameras=(_AWAY,), outputs=frozenset({"mask2d"}))
    for answers in (_over_rest(faces, query), _over_grpc(faces, query)):
        ((view, index, height, width, _, area),) = answers[0]["masks"]
        assert (view, index, height, width, area) == ("", 0, 36, 48, 0)


@pytest.mark.parametrize("kind", ["rgb", "overlay", "relevancy", "mask"])
def test_pictures_are_the_same_bytes(faces: Faces, service: SceneService, scene_id: str, kind: str) -> None:
    text = None if kind == "rgb" else "ball"
    wire_kind = pb.PictureKind.Value(f"PICTURE_KIND_{kind.upper()}")
    for view in _VIEWS:
        truth = service.view_picture(scene_id, text, kind, None, view)  # type: ignore[arg-type]
        assert Image.open(io.BytesIO(truth)).size == (48, 36)
        params = {"view": view} | ({"text": text} if text else {})
        response = faces.rest.get(f"/v1/scenes/{scene_id}/{kind}.png", params=params)
        assert response.headers["content-type"] == "image/png" and response.content == truth
        request = pb.RenderViewRequest(scene_id=scene_id, kind=wire_kind, text=text or "", view=view)
        assert b"".join(chunk.data for chunk in faces.rpc.RenderView(request)) == truth
    camera = turned(0.25)
    truth = service.view_picture(scene_id, text, kind, camera, None)  # type: ignore[arg-type]
    body = {"kind": kind, "text": text, "camera": rest_camera_out(camera).model_dump()}
    assert faces.rest.post(f"/v1/scenes/{scene_id}:render", json=body).content == truth
    request = pb.RenderViewRequest(scene_id=scene_id, kind=wire_kind, text=text or "", camera=camera_out(camera))
    assert b"".join(chunk.data for chunk in faces.rpc.RenderView(request)) == truth


def test_files_are_the_same_bytes(faces: Faces, service: SceneService, scene_id: str) -> None:
    truth = service.scene_ply(scene_id)[0].read_bytes()
    response = faces.rest.get(f"/v1/scenes/{scene_id}/scene.ply")
    assert response.content == truth and response.headers["etag"]
    part = faces.rest.get(f"/v1/scenes/{scene_id}/scene.ply", headers={"Range": "bytes=10-19"})
    assert part.status_code == 206 and part.content == truth[10:20]
    chunks = faces.rpc.DownloadScenePly(pb.DownloadScenePlyRequest(scene_id=scene_id))
    assert b"".join(chunk.data for chunk in chunks) == truth

    mask = service.mask_ply(scene_id, "mug")
    assert faces.rest.get(f"/v1/scenes/{scene_id}/mask.ply", params={"text": "mug"}).content == mask
    chunks = faces.rpc.DownloadMaskPly(pb.DownloadMaskPlyRequest(scene_id=scene_id, text="mug"))
    assert b"".join(chunk.data for chunk in chunks) == mask

    (truth3d,) = service.query(QueryRequest(scene_id, ("mug",), outputs=frozenset({"mask3d"})))
    packed = faces.rest.get(f"/v1/scenes/{scene_id}/mask3d.bin", params={"text": "mug"})
    assert packed.content == truth3d.mask3d
    bits = np.unpackbits(np.frombuffer(packed.content, np.uint8))[: int(packed.headers["x-gaussian-count"])]
    assert bits[:60].all() and not bits[60:].any()  # the mug's rows come first


def test_scenes_and_operations_read_the_same(faces: Faces, service: SceneService, scene_id: str) -> None:
    truth = service.get_scene(scene_id)
    body = faces.rest.get(f"/v1/scenes/{scene_id}").json()
    message = faces.rpc.GetScene(pb.GetSceneRequest(scene_id=scene_id))
    assert body["name"] == message.name == truth.name
    assert body["gaussians"] == message.gaussians == 240
    assert body["scale"] == "METRIC" and message.scale == pb.SCALE_METRIC
    assert [row["label"] for row in body["dictionary"]] == [row.label for row in message.dictionary] == list(LABELS)
    assert body["quality"]["stage_seconds"]["training"] == message.quality["stage_seconds"]["training"] == 12.5
    for posed, one, other in zip(truth.cameras, body["cameras"], message.cameras, strict=True):
        assert one["name"] == other.name == posed.name
        for name in "xyzw":
            assert one["orientation"][name] == getattr(other.orientation, name)
        assert [one["position"][name] for name in "xyz"] == posed.world_from_camera[:3, 3].tolist()

    operation = faces.rest.get(f"/v1/operations/{truth.operation_id}").json()
    waited = faces.rest.get(f"/v1/operations/{truth.operation_id}:wait", params={"timeout_s": 0}).json()
    called = faces.rpc.GetOperation(pb.GetOperationRequest(operation_id=truth.operation_id))
    watched = list(faces.rpc.WatchOperation(pb.WatchOperationRequest(operation_id=truth.operation_id)))
    assert operation == waited and watched == [called]
    assert operation["state"] == "SUCCEEDED" and called.state == pb.OPERATION_STATE_SUCCEEDED
    assert operation["done"] and called.done
    assert operation["stages"][0]["metrics"] == dict(called.stages[0].metrics) == {"psnr": 31.5}
    moment = truth.created_at.isoformat().replace("+00:00", "Z")
    assert body["created_at"] == moment and message.created_at.ToDatetime(truth.created_at.tzinfo) == truth.created_at


def test_lists_page_alike(faces: Faces, service: SceneService, scene_id: str) -> None:
    page, _ = service.list_scenes(1, "")
    body = faces.rest.get("/v1/scenes", params={"page_size": 1}).json()
    message = faces.rpc.ListScenes(pb.ListScenesRequest(page_size=1))
    assert [scene["id"] for scene in body["scenes"]] == [scene.id for scene in message.scenes] == [page[0].id]
    assert body["next_page_token"] == message.next_page_token
    assert "cameras" not in body["scenes"][0] and not message.scenes[0].cameras
