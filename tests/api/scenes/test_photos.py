"""Photos of a scene over both faces, and what became of each of them."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.answering.photos import photo_page
from fastsplat.service.application.service import SceneService
from fastsplat.service.capture.photos.scene_photos import photo_path
from fastsplat.service.settings import Settings
from fastsplat.service.store.blobs.blobs import remove
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotFoundError, SceneFileError
from fastsplat_contract.messages.scenes import Edit
from fastsplat_contract.photos.photo_verdicts import PhotoVerdict
from tests.api.calls import over_grpc
from tests.api.clients import assert_same, client_of, outcome
from tests.api.made_scene import PHOTO_COLORS, add_scene
from tests.api.served import Faces
from tests.scenes import claimed_job

_VIEWS = ("front.png", "photos/left side & ü.png", "a/b/right.png")
_HOSTILE = (
    "../../../../etc/passwd", "..", "", "\0", "/etc/passwd", "00000.jpg", "front.png/../x", "%2e%2e%2f", "a" * 5000
)  # fmt: skip


def test_photos_are_listed_and_are_the_same_bytes(faces: Faces, service: SceneService, scene_id: str) -> None:
    truth = service.photos.all(scene_id)
    assert [photo.view for photo in truth.photos] == list(_VIEWS)
    with client_of(faces) as client:
        assert tuple(client.photos(scene_id)) == truth.photos
        for photo, color in zip(truth.photos, PHOTO_COLORS, strict=True):
            path, version = service.photos.path(scene_id, photo.view)
            content = path.read_bytes()
            assert version == truth.version and len(content) == photo.size_bytes
            assert client.photo(scene_id, photo.view) == content
            with Image.open(io.BytesIO(content)) as image:  # it is the photo of that camera
                assert np.abs(np.asarray(image).mean(axis=(0, 1)) - color).max() < 10
    response = faces.rest.get(f"/v1/scenes/{scene_id}/photo.jpg", params={"view": "front.png"})
    assert response.headers["content-type"] == "image/jpeg"
    tag = {"If-None-Match": response.headers["etag"]}
    again = faces.rest.get(f"/v1/scenes/{scene_id}/photo.jpg", params={"view": "front.png"}, headers=tag)
    assert again.status_code == 304


@pytest.mark.parametrize("view", [*_HOSTILE, "front.png\n"])
def test_a_name_that_no_camera_has_reads_no_file(faces: Faces, service: SceneService, scene_id: str, view: str) -> None:
    truth = outcome(lambda: service.photos.path(scene_id, view))
    assert truth[0] in (NotFoundError, InvalidInputError, LimitExceededError) and truth[2]["field"] == "view"
    with client_of(faces) as client:
        assert outcome(lambda: client.photo(scene_id, view)) == truth


def test_a_scene_without_photos_says_so(faces: Faces, service: SceneService, api_settings: Settings) -> None:
    scene_id = add_scene(service, api_settings, "old")
    folder = service._store.blobs.version(scene_id, service.get_scene(scene_id).version)
    remove(photo_path(folder, 0).parent)
    assert service.photos.all(scene_id).photos == ()
    with pytest.raises(NotFoundError) as refused:
        service.photos.path(scene_id, "front.png")
    assert "FASTSPLAT_PHOTOS__KEEP" in refused.value.hint
    with client_of(faces) as client:
        assert tuple(client.photos(scene_id)) == ()
        truth = outcome(lambda: service.photos.path(scene_id, "front.png"))
        assert outcome(lambda: client.photo(scene_id, "front.png")) == truth
        assert not any(view.photo for view in client.best_views(scene_id, 1))
    service.delete_scene(scene_id)


def test_versions_share_their_photos(service: SceneService, api_settings: Settings) -> None:
    scene_id = add_scene(service, api_settings, "edited")
    first, before = service.photos.path(scene_id, _VIEWS[1])
    edited = service.versions.edit(scene_id, [Edit("remove", label="ball")])
    second, after = service.photos.path(scene_id, _VIEWS[1])
    assert (before, after) == ("1", edited.version) and first != second and first.samefile(second)
    assert len(service.photos.all(scene_id).photos) == 3
    service._store.blobs.check_version(second.parent.parent)
    assert "photos/00001.jpg" in (second.parent.parent / "files.sha256").read_text()
    # Damage is said, as of any file of a version.
    second.unlink()
    second.write_bytes(first.read_bytes()[:-1] + b"x")
    with pytest.raises(SceneFileError, match=r"photos/00001\.jpg"):
        service.photos.path(scene_id, _VIEWS[1])
    service.delete_scene(scene_id)


def test_a_best_view_shows_where_the_object_is(service: SceneService, scene_id: str) -> None:
    listed = service.photos.best_views(scene_id, (1,))
    assert {view.view for view in listed.views} == set(_VIEWS) and all(view.photo for view in listed.views)
    worth = [view.share * (0.4 if view.cut_off else 1) for view in listed.views]
    assert worth == sorted(worth, reverse=True)
    for view in listed.views:
        mask = view.mask.array()
        assert mask.mean() == pytest.approx(view.share) and view.mask.area == mask.sum() > 0
        posed = next(camera for camera in service.get_scene(scene_id).cameras if camera.name == view.view)
        row, column = (int(index.mean()) for index in np.nonzero(mask))  # the blob's middle
        assert np.abs(posed.pixels(np.array([-0.8, 0.0, 4.0])) - (column, row)).max() < 4
    assert service.photos.best_views(scene_id, text="volcano").views == ()


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
    claim = claimed_job(service._store)
    scene_id = claim.operation.scene_id
    truth = tuple(_verdict(number) for number in range(7))
    assert service.list_photo_verdicts(scene_id) == ((), "", False, 0, 0)
    service._store.jobs.record_photos(claim, [to_plain(verdict) for verdict in truth])
    page = service.list_photo_verdicts(scene_id, page_size=3)
    assert (page.photos, page.assessed, page.placed_count, page.photo_count) == (truth[:3], True, 4, 7)
    with client_of(faces) as client:
        assert_same(tuple(client.photo_verdicts(scene_id)), truth)
        over_rest = faces.rest.get(f"/v1/scenes/{scene_id}/photo-verdicts", params={"page_size": 3}).json()
        assert over_rest == to_plain(page)
        assert_same(over_grpc(faces, "ListPhotoVerdicts", {"scene_id": scene_id}, {"page_size": 3}), page)
        rest = {"page_size": 5, "page_token": page.next_page_token}
        assert_same(over_grpc(faces, "ListPhotoVerdicts", {"scene_id": scene_id}, rest).photos, truth[3:])
        service.delete_scene(scene_id)
        with pytest.raises(NotFoundError):
            list(client.photo_verdicts(scene_id))


def test_what_training_estimated_of_a_photo_is_in_its_verdict() -> None:
    rows = [to_plain(_verdict(number)) for number in range(3)]
    quality = {"photometric": {rows[1]["name"]: [-0.5, 0.02, 0.0]}}
    page = photo_page(rows, quality, 10, "", "a")
    assert [photo.exposure_ev for photo in page.photos] == [None, -0.5, 0.25]
    assert (page.photos[1].red_ev, page.photos[1].blue_ev) == (0.02, 0.0)
