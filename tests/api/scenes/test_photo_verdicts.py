"""What became of the photos of a capture, over both protocols and in process."""

from __future__ import annotations

import pytest

from fastsplat.service.application.answering.photos import photo_page
from fastsplat.service.application.service import SceneService
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.codec.proto_codec import from_proto
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.photos.photo_verdicts import PhotoVerdict
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import assert_same, client_of
from tests.api.served import Faces
from tests.scenes import queued_job


def _verdict(number: int) -> PhotoVerdict:
    placed = number % 3 != 0
    return PhotoVerdict(
        name=f"<b>{number:03}</b> ü.jpg",
        placed=placed,
        not_placed=None if placed else "few_matches",
        defects=("blurred", "duplicate") if number % 2 else (),
        duplicate_of="000.jpg" if number % 2 else "",
        sharpness=0.25 * number,
        brightness=0.75,
        matches=None if number == 4 else number,
        advice="Take it again." if number % 2 else "",
        exposure_ev=0.25 if number == 2 else None,
        red_ev=0.0 if number == 2 else None,
        blue_ev=-0.125 if number == 2 else None,
    )


def test_verdicts_are_the_same_over_each_face_while_the_job_still_runs(faces: Faces, service: SceneService) -> None:
    job = queued_job()
    service._store.scenes.create(job)
    claim = service._store.jobs.claim(job.operation_id)
    assert claim is not None
    truth = tuple(_verdict(number) for number in range(7))
    assert service.list_photo_verdicts(job.scene_id) == ((), "", False, 0, 0)
    service._store.jobs.record_photos(claim, [to_plain(verdict) for verdict in truth])
    page = service.list_photo_verdicts(job.scene_id, page_size=3)
    assert (page.photos, page.assessed, page.placed_count, page.photo_count) == (truth[:3], True, 4, 7)
    with client_of(faces) as client:
        assert_same(tuple(client.photo_verdicts(job.scene_id)), truth)
        over_rest = faces.rest.get(f"/v1/scenes/{job.scene_id}/photo-verdicts", params={"page_size": 3}).json()
        assert over_rest == to_plain(page)
        token, read = "", []
        while True:
            request = pb.ListPhotoVerdictsRequest(scene_id=job.scene_id, page_size=3, page_token=token)
            answer = faces.rpc.ListPhotoVerdicts(request)
            read += [from_proto(PhotoVerdict, photo) for photo in answer.photos]
            assert (answer.assessed, answer.placed_count, answer.photo_count) == (True, 4, 7)
            if not (token := answer.next_page_token):
                break
        assert_same(tuple(read), truth)
        service.delete_scene(job.scene_id)
        with pytest.raises(NotFoundError):
            list(client.photo_verdicts(job.scene_id))


def test_what_training_estimated_of_a_photo_is_in_its_verdict() -> None:
    rows = [to_plain(_verdict(number)) for number in range(3)]
    quality = {"photometric": {rows[1]["name"]: [-0.5, 0.02, 0.0]}}
    page = photo_page(rows, quality, 10, "", "a")
    assert [photo.exposure_ev for photo in page.photos] == [None, -0.5, 0.25]
    assert (page.photos[1].red_ev, page.photos[1].blue_ev) == (0.02, 0.0)
