"""Scenes as files for other programs: the same bytes by every way, and what is in them."""

from __future__ import annotations

import importlib
import io
import shutil
import sys
import zipfile
from pathlib import Path
from typing import get_args

import grpc
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from fastsplat.service.application.exporting.scene_exports import _WRITERS
from fastsplat.service.application.exporting.scene_page import TEMPLATE
from fastsplat.service.application.service import SceneService
from fastsplat.service.capture.uploads.splat_files.rows import SplatLimits
from fastsplat.service.capture.uploads.splat_files.spz import read_spz
from fastsplat.service.scene.formats.ply import read_ply
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import InvalidInputError, NotFoundError, SceneFileError
from fastsplat_contract.messages.exports import FILE_NAMES, FORMATS, ExportFormat, ExportRequest
from fastsplat_contract.messages.scenes import Edit
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import client_of
from tests.api.made_scene import add_scene
from tests.api.served import Faces, rest_refusal, rpc_refusal


def _rpc(faces: Faces, scene_id: str, name: str, objects: tuple[int, ...] = ()) -> bytes:
    request = pb.ExportSceneRequest(
        scene_id=scene_id, format=pb.ExportFormat.Value(f"EXPORT_FORMAT_{name.upper()}"), object_ids=objects
    )
    return b"".join(chunk.data for chunk in faces.rpc.ExportScene(request))


def test_each_format_has_its_row_its_writer_its_number_and_its_line_in_the_document() -> None:
    listed, numbers = (Path(__file__).parents[3] / "docs/take_away.md").read_text(), pb.ExportFormat.keys()
    for name in get_args(ExportFormat):
        assert name in FORMATS and name in _WRITERS and f"| `{name}`" in listed
        assert f"EXPORT_FORMAT_{name.upper()}" in numbers
    assert len(get_args(ExportFormat)) == len(FORMATS) == len(_WRITERS) == len(numbers) - 1
    assert len({facts.ending for facts in FORMATS.values()}) == len(FORMATS), "the ending says the format"


@pytest.mark.parametrize("name", ["ply", "spz", "points", "mesh", "cameras", "sog", "mcap"])
def test_an_export_is_a_file_that_is_not_sent_again(
    faces: Faces, service: SceneService, scene_id: str, name: ExportFormat
) -> None:
    objects = (1,)
    truth = service.exports.file(ExportRequest(scene_id, name, object_ids=objects))
    response = faces.rest.get(f"/v1/scenes/{scene_id}/scene.{name}", params={"object_ids": list(objects)})
    assert response.headers["content-disposition"] == f'attachment; filename="{FILE_NAMES[name]}"'
    tag = {"If-None-Match": response.headers["etag"]}
    again = faces.rest.get(f"/v1/scenes/{scene_id}/scene.{name}", params={"object_ids": list(objects)}, headers=tag)
    assert (again.status_code, again.content) == (304, b"")
    with client_of(faces) as client:
        assert client.export(scene_id, name, objects=objects) == truth


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
    some = rest_refusal(faces.rest.get(f"/v1/scenes/{scene_id}/scene.html", params={"object_ids": 1}))
    assert (some.code, some.details["field"]) == (400, "object_ids")


def test_one_object_alone_has_the_rows_that_are_its(
    faces: Faces, service: SceneService, scene_id: str, tmp_path: Path
) -> None:
    with client_of(faces) as client:
        owners = client.object_ids(scene_id)
        (tmp_path / "2.ply").write_bytes(client.export(scene_id, "ply", objects=[2]))
        (tmp_path / "2.spz").write_bytes(client.export(scene_id, "spz", objects=[2]))
    whole = read_ply(service.answers.scene_ply(scene_id)[0])
    single = read_ply(tmp_path / "2.ply")
    assert 0 < len(single) < len(whole)
    np.testing.assert_array_equal(single.means, whole.means[owners == 2])
    np.testing.assert_array_equal(single.sh, whole.sh[owners == 2])
    packed = read_spz(tmp_path / "2.spz", "2.spz", SplatLimits(10**6))
    np.testing.assert_allclose(packed.means, single.means, atol=1e-5)


def test_a_map_is_a_zip_with_every_shade(faces: Faces, upright_id: str) -> None:
    response = faces.rest.get(f"/v1/scenes/{upright_id}/scene.map", params={"cell": 0.1})
    assert response.headers["content-type"] == "application/zip"
    assert response.headers["content-disposition"] == 'attachment; filename="scene.map.zip"'
    with zipfile.ZipFile(io.BytesIO(response.content)) as archive:
        assert set(archive.read("map.pgm").split(b"255\n", 1)[1]) == {0, 205, 254}
    refusal = rest_refusal(faces.rest.get(f"/v1/scenes/{upright_id}/scene.map", params={"object_ids": 1}))
    assert (refusal.code, refusal.details["field"]) == (400, "object_ids")


def test_a_cell_of_points_is_a_number_above_zero_that_leaves_fewer(service: SceneService, scene_id: str) -> None:
    fewer, every = (service.exports.file(ExportRequest(scene_id, "points", cell=cell)) for cell in (0.2, 0.0))
    assert len(fewer) < len(every)
    for cell in (-1.0, float("nan")):
        with pytest.raises(InvalidInputError, match="cell"):
            service.exports.file(ExportRequest(scene_id, "points", cell=cell))


def test_foxglove_files_hold_the_stored_photos_and_the_time_of_the_version(
    service: SceneService, scene_id: str
) -> None:
    reader = make_reader(
        io.BytesIO(service.exports.file(ExportRequest(scene_id, "mcap"))), decoder_factories=[DecoderFactory()]
    )
    images = [
        (message.log_time, decoded.data) for _, _, message, decoded in reader.iter_decoded_messages("/camera/image")
    ]
    names = [photo.view for photo in service.photos.all(scene_id).photos]
    assert [data for _, data in images] == [service.photos.path(scene_id, name)[0].read_bytes() for name in names]
    current = service.get_scene(scene_id).version
    (version,) = (record for record in service.versions.all(scene_id) if record.version == current)
    assert len(images) == 3 and images[0][0] == pytest.approx(version.created_at.timestamp() * 1e9, abs=1e6)
    about = next(record.metadata for record in reader.iter_metadata() if record.name == "scene")
    assert (about["scene_id"], about["version"], about["photos"]) == (scene_id, version.version, "3")


def test_a_file_for_foxglove_without_the_package_that_writes_it_is_refused_alike(
    faces: Faces, scene_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = importlib.import_module("fastsplat.service.application.exporting.foxglove_file")
    monkeypatch.delitem(sys.modules, writer.__name__)
    monkeypatch.delattr(writer.__name__)
    monkeypatch.setitem(sys.modules, "foxglove", None)
    rest = rest_refusal(faces.rest.get(f"/v1/scenes/{scene_id}/scene.mcap"))
    with pytest.raises(grpc.RpcError) as caught:
        _rpc(faces, scene_id, "mcap")
    assert rest.details == rpc_refusal(caught.value).details and rest.details["field"] == "format"
    assert "foxglove-sdk" in rest.detail and "fastsplat[robots]" in rest.details["hint"]


def test_photos_that_are_damaged_or_gone_refuse_the_foxglove_file(
    service: SceneService, api_settings: Settings
) -> None:
    scene_id = add_scene(service, api_settings, "with photos")
    edited = service.versions.edit(scene_id, [Edit("remove", label="ball")])
    content = service.exports.file(ExportRequest(scene_id, "mcap"))
    summary = make_reader(io.BytesIO(content)).get_summary()
    assert summary is not None and summary.statistics is not None
    made_at = edited.created_at.timestamp() * 1e9
    assert summary.statistics.message_start_time == pytest.approx(made_at, abs=1e6)
    photo, _ = service.photos.path(scene_id, "front.png")
    damaged = photo.read_bytes()[:-1] + b"x"
    photo.unlink()
    photo.write_bytes(damaged)
    with pytest.raises(SceneFileError, match=photo.name):
        service.exports.file(ExportRequest(scene_id, "mcap"))
    assert len(service.exports.file(ExportRequest(scene_id, "points"))) > 0
    shutil.rmtree(photo.parent.parent)
    with pytest.raises(NotFoundError, match="deleted meanwhile"):
        service.exports._photo_contents(scene_id, edited.version, [0])
    service.delete_scene(scene_id)
