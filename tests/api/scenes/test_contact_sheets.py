"""Sheets show every object without a name once, from its photo where that shows what the version shows."""

from __future__ import annotations

import io
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.application.base.paging import page_of
from fastsplat.service.application.service import SceneService
from fastsplat.service.capture.photos.scene_photos import photo_path
from fastsplat.service.jobs.nameless_objects import written_on
from fastsplat.service.query.drawing.contact_sheets import MOST_OBJECTS, cell_side, contact_sheet, object_cell
from fastsplat.service.settings import Settings
from fastsplat.service.store.blobs.blobs import remove
from fastsplat_client import Client, ContactSheet, SuggestedName
from fastsplat_contract.errors import InvalidInputError, SceneFileError
from fastsplat_contract.messages.object_reads import ObjectRead, ReadKind
from fastsplat_contract.messages.objects import SceneObject
from fastsplat_contract.messages.scenes import Edit
from tests.api.made_scene import PHOTO_COLORS, add_scene

_VIEWS = ("front.png", "photos/left side & ü.png", "a/b/right.png")
_OWN_COLORS = {1: 0, 2: 1, 3: 2}  # which channel is the strongest of each object's Gaussians


@pytest.fixture
def nameless(service: SceneService, api_settings: Settings) -> Iterator[str]:
    """A scene of three objects that nobody named."""
    scene_id = add_scene(service, api_settings, "nameless")
    service.versions.edit(scene_id, [Edit("unname", object_ids=(1, 2, 3))])
    yield scene_id
    service.delete_scene(scene_id)


def _middles(sheet: ContactSheet) -> list[NDArray[np.float64]]:
    """The mean color around the middle of each object's cell."""
    with Image.open(io.BytesIO(sheet.picture)) as image:
        assert image.format == "JPEG" and max(image.size) <= 768
        pixels = np.asarray(image).astype(np.float64)
    side = cell_side(len(sheet.objects))
    columns = pixels.shape[1] // side
    middles = []
    for place in range(len(sheet.objects)):
        y, x = place // columns * side + side // 2, place % columns * side + side // 2
        middles.append(pixels[y - 8 : y + 8, x - 8 : x + 8].mean(axis=(0, 1)))
    return middles


def test_each_object_is_cut_from_the_photo_of_its_view(client: Client, service: SceneService, nameless: str) -> None:
    (sheet,) = client.contact_sheets(nameless)
    assert [(obj.number, obj.object_id) for obj in sheet.objects] == [(1, 1), (2, 2), (3, 3)]
    assert sheet.meters and not sheet.unseen and sheet.version == service.get_scene(nameless).version
    listed = {obj.id: obj for obj in client.objects(nameless)}
    for entry, middle in zip(sheet.objects, _middles(sheet), strict=True):
        best = service.photos.best_views(nameless, (entry.object_id,), max_views=1).views
        assert entry.photo and entry.view == best[0].view
        assert np.abs(middle - PHOTO_COLORS[_VIEWS.index(entry.view)]).max() < 12
        box = listed[entry.object_id].box
        assert box is not None and entry.size == box.size
    assert [near.object_id for near in sheet.objects[0].neighbors] == [2, 3]  # they stand in a row


def test_what_edits_changed_is_shown_as_the_version_shows_it(
    client: Client, service: SceneService, nameless: str
) -> None:
    service.versions.edit(nameless, [Edit("remove", object_ids=(2,))])
    (sheet,) = client.contact_sheets(nameless)
    assert [obj.object_id for obj in sheet.objects] == [1, 3] and not any(obj.photo for obj in sheet.objects)
    for entry, middle in zip(sheet.objects, _middles(sheet), strict=True):
        assert middle.argmax() == _OWN_COLORS[entry.object_id]


def test_without_photos_the_scene_is_shown(client: Client, service: SceneService, nameless: str) -> None:
    remove(photo_path(service._store.blobs.version(nameless, service.get_scene(nameless).version), 0).parent)
    (sheet,) = client.contact_sheets(nameless)
    for entry, middle in zip(sheet.objects, _middles(sheet), strict=True):
        assert not entry.photo and middle.argmax() == _OWN_COLORS[entry.object_id]


def test_a_damaged_photo_is_said(service: SceneService, nameless: str) -> None:
    folder = service._store.blobs.version(nameless, service.get_scene(nameless).version)
    for number in range(3):
        path = photo_path(folder, number)
        content = path.read_bytes()
        path.unlink()
        path.write_bytes(content[:-1] + b"x")
    with pytest.raises(SceneFileError, match=r"photos/0000"):
        service.sheets.page(nameless)


def test_pages_show_all_also_where_names_are_suggested_and_given_between_them(client: Client, nameless: str) -> None:
    seen = []
    for sheet in client.contact_sheets(nameless):  # its pages are of 20
        seen += [obj.object_id for obj in sheet.objects]
    assert seen == [1, 2, 3]
    first = client._transport.call("GET", f"/v1/scenes/{nameless}/objects/sheet", params={"page_size": 1}).json()
    assert [obj["object_id"] for obj in first["objects"]] == [1]
    client.suggest_names(nameless, [SuggestedName(3, "violin", 0.7, "eyes", "v1")])
    client.name_objects(nameless, 1, "moon")
    params = {"page_size": 500, "page_token": first["next_page_token"]}
    rest = client._transport.call("GET", f"/v1/scenes/{nameless}/objects/sheet", params=params).json()
    assert [obj["object_id"] for obj in rest["objects"]] == [2, 3] and not rest["next_page_token"]
    assert [near["name"] for near in rest["objects"][0]["neighbors"]].count("moon") == 1
    assert [suggestion["name"] for suggestion in rest["objects"][1]["suggestions"]] == ["violin"]


@pytest.mark.parametrize("count", [1, 2, 5, MOST_OBJECTS])
def test_cells_stand_in_rows_by_number(count: int) -> None:
    side = cell_side(count)
    colors = np.random.default_rng(count).integers(30, 220, size=(count, 3))
    cells = [np.full((side, side // 2, 3), color, np.uint8) for color in colors]
    with Image.open(io.BytesIO(contact_sheet(cells))) as image:
        pixels = np.asarray(image).astype(int)
    assert max(pixels.shape) <= 768
    columns = pixels.shape[1] // side
    for place, color in enumerate(colors):
        y, x = place // columns * side, place % columns * side
        assert np.abs(pixels[y + side // 2, x + side // 2] - color).max() < 12
        corner = pixels[y : y + 24, x : x + 30]
        assert (corner > 240).all(axis=2).any()  # white digits on black


@given(data=st.data())
def test_a_cut_holds_the_whole_object_and_a_line_around_it(data: st.DataObject) -> None:
    height, width = data.draw(st.integers(20, 60)), data.draw(st.integers(20, 60))
    top, left = data.draw(st.integers(0, height - 3)), data.draw(st.integers(0, width - 3))
    bottom, right = data.draw(st.integers(top + 3, height)), data.draw(st.integers(left + 3, width))
    mask = np.zeros((height, width), np.bool_)
    mask[top:bottom, left:right] = True
    picture = np.repeat(np.repeat(np.where(mask[..., None], [0, 0, 255], [60, 60, 60]), 2, 0), 2, 1).astype(np.uint8)
    cell = object_cell(picture, mask, 150).astype(int)
    assert max(cell.shape[:2]) == 150
    scale = 150 / (max(bottom - top, right - left, 12) * 2.5)  # at least so large: 0.3 around, and whole pixels
    inside = (np.abs(cell - [0, 0, 255]).max(axis=2) < 40).sum()
    line = (np.abs(cell - [255, 230, 0]).max(axis=2) < 40).sum()
    assert inside > 0.4 * (bottom - top - 1) * (right - left - 1) * scale**2 and line > 0


def test_pixels_far_from_an_object_do_not_make_it_small() -> None:
    mask = np.zeros((100, 100), np.bool_)
    mask[40:60, 40:60] = True
    picture = np.where(mask[..., None], [0, 0, 255], [60, 60, 60]).astype(np.uint8)
    clean = object_cell(picture, mask, 150)
    mask[2, 3] = mask[90:92, 97] = True
    assert (object_cell(picture, mask, 150) == clean).all()


@given(st.lists(st.integers(1, 99), unique=True), st.integers(1, 5), st.data())
def test_pages_by_number_miss_nothing_that_stays(numbers: list[int], size: int, data: st.DataObject) -> None:
    rows, stays, seen, token = sorted(numbers), set(numbers), [], ""
    while True:
        page, token = page_of(rows, size, token, "rows", int)
        assert len(page) <= size
        seen += page
        if not token:
            break
        gone = set(data.draw(st.lists(st.sampled_from(rows), max_size=2)))
        stays -= gone
        rows = [row for row in rows if row not in gone]
    assert seen == sorted(set(seen)) and stays <= set(seen)
    with pytest.raises(InvalidInputError):
        page_of([1], 1, page_of([1, 2], 1, "", "others", int)[1], "rows", int)


def test_lines_of_all_objects_are_told_once_the_likeliest_first_and_not_without_end() -> None:
    def obj(number: int, *reads: tuple[ReadKind, str, float]) -> SceneObject:
        object_reads = tuple(ObjectRead(kind, text, probability, 2) for kind, text, probability in reads)
        return SceneObject(number, "mug", "person", 1.0, (), "object", "", 1.0, 10, None, True, reads=object_reads)

    poster = obj(1, ("text", "everything cat", 0.9), ("qr", "https://a.example", 1.0))
    box = obj(2, ("text", "OAT MILK", 0.7), ("text", "everything cat", 0.6), ("tag", "12", 1.0))
    assert written_on([box, poster]) == ("everything cat", "OAT MILK")
    many = [obj(n, *(("text", f"line {20 * n + k}", 0.5) for k in range(20))) for n in range(1, 15)]
    assert len(written_on([*many, poster])) == 200 and written_on([*many, poster])[0] == "everything cat"
