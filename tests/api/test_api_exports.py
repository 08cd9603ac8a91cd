"""Scenes as files for other programs: the same bytes by every way, and what is in them."""

from __future__ import annotations

from pathlib import Path

import grpc
import numpy as np
import pytest

from fastsplat.service.application.scene_page import TEMPLATE
from fastsplat.service.application.service import SceneService
from fastsplat.service.capture.splat_files.limits import SplatLimits
from fastsplat.service.capture.splat_files.spz import read_spz
from fastsplat.service.scene import read_ply
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.exports import FILE_NAMES, ExportFormat, ExportRequest
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import client_of
from tests.api.served import Faces, rest_refusal, rpc_refusal


def _rpc(faces: Faces, scene_id: str, name: str, things: tuple[int, ...] = ()) -> bytes:
    request = pb.ExportSceneRequest(
        scene_id=scene_id, format=pb.ExportFormat.Value(f"EXPORT_FORMAT_{name.upper()}"), things=things
    )
    return b"".join(chunk.data for chunk in faces.rpc.ExportScene(request))


@pytest.mark.parametrize("name", ["ply", "spz", "points", "glb", "mesh", "cameras"])
@pytest.mark.parametrize("things", [(), (1,), (1, 2)])
def test_exports_are_the_same_bytes(
    faces: Faces, service: SceneService, scene_id: str, name: ExportFormat, things: tuple[int, ...]
) -> None:
    truth = service.exports.file(ExportRequest(scene_id, name, things=things))
    assert _rpc(faces, scene_id, name, things) == truth
    response = faces.rest.get(f"/v1/scenes/{scene_id}/scene.{name}", params={"thing": list(things)})
    assert response.content == truth
    assert response.headers["content-disposition"] == f'attachment; filename="{FILE_NAMES[name]}"'
    tag = {"If-None-Match": response.headers["etag"]}
    again = faces.rest.get(f"/v1/scenes/{scene_id}/scene.{name}", params={"thing": list(things)}, headers=tag)
    assert (again.status_code, again.content) == (304, b"")
    with client_of(faces) as client:
        assert client.export(scene_id, name, things=things) == truth


def test_the_page_of_a_scene_is_the_same_bytes(faces: Faces, service: SceneService, scene_id: str) -> None:
    if not TEMPLATE.is_file():
        refusal = rest_refusal(faces.rest.get(f"/v1/scenes/{scene_id}/scene.html"))
        assert refusal.code == 404 and "make page" in refusal.details["hint"]
        pytest.skip("the page is not built: make page")
    truth = service.exports.file(ExportRequest(scene_id, "html"))
    response = faces.rest.get(f"/v1/scenes/{scene_id}/scene.html")
    assert response.content == truth == _rpc(faces, scene_id, "html")
    assert response.headers["content-disposition"].startswith("attachment")
    assert response.headers["content-security-policy"] == "sandbox"
    some = rest_refusal(faces.rest.get(f"/v1/scenes/{scene_id}/scene.html", params={"thing": 1}))
    assert (some.code, some.details["field"]) == (400, "things")


def test_one_thing_alone_has_the_rows_that_are_its(
    faces: Faces, service: SceneService, scene_id: str, tmp_path: Path
) -> None:
    with client_of(faces) as client:
        owners = client.thing_ids(scene_id)
        (tmp_path / "2.ply").write_bytes(client.export(scene_id, "ply", things=[2]))
        (tmp_path / "2.spz").write_bytes(client.export(scene_id, "spz", things=[2]))
    whole = read_ply(service.answers.scene_ply(scene_id)[0])
    one = read_ply(tmp_path / "2.ply")
    assert 0 < len(one) < len(whole)
    np.testing.assert_array_equal(one.means, whole.means[owners == 2])
    np.testing.assert_array_equal(one.sh, whole.sh[owners == 2])
    packed = read_spz(tmp_path / "2.spz", "2.spz", SplatLimits(10**6))
    np.testing.assert_allclose(packed.means, one.means, atol=1e-5)


def test_an_unknown_thing_is_refused_alike(faces: Faces, service: SceneService, scene_id: str) -> None:
    for name in ("ply", "spz"):
        rest = rest_refusal(faces.rest.get(f"/v1/scenes/{scene_id}/scene.{name}", params={"thing": 4_000}))
        with pytest.raises(grpc.RpcError) as caught:
            _rpc(faces, scene_id, name, (4_000,))
        assert rest.code == 404 and rest.details == rpc_refusal(caught.value).details
    with pytest.raises(NotFoundError):
        service.exports.file(ExportRequest(scene_id, "spz", things=(4_000,)))
    assert faces.rest.get(f"/v1/scenes/{scene_id}/scene.exe").status_code == 400


def test_the_cell_of_points_goes_every_way(faces: Faces, service: SceneService, scene_id: str) -> None:
    truth = service.exports.file(ExportRequest(scene_id, "points", cell=0.2))
    assert len(truth) < len(service.exports.file(ExportRequest(scene_id, "points")))
    request = pb.ExportSceneRequest(scene_id=scene_id, format=pb.EXPORT_FORMAT_POINTS, cell=0.2)
    assert b"".join(chunk.data for chunk in faces.rpc.ExportScene(request)) == truth
    assert faces.rest.get(f"/v1/scenes/{scene_id}/scene.points", params={"cell": 0.2}).content == truth
    with client_of(faces) as client:
        assert client.export(scene_id, "points", cell=0.2) == truth
    for name, cell in (("points", -1.0), ("points", float("nan")), ("spz", 0.2)):
        refusal = rest_refusal(faces.rest.get(f"/v1/scenes/{scene_id}/scene.{name}", params={"cell": cell}))
        assert refusal.code == 400 and "cell" in refusal.details["field"]
        value = pb.ExportFormat.Value(f"EXPORT_FORMAT_{name.upper()}")
        asked = pb.ExportSceneRequest(scene_id=scene_id, format=value, cell=cell)
        with pytest.raises(grpc.RpcError) as caught:
            list(faces.rpc.ExportScene(asked))
        assert caught.value.code() == grpc.StatusCode.INVALID_ARGUMENT
