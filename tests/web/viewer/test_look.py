"""How a scene is looked at: photos beside it, cameras in it, and what its colors say."""

from __future__ import annotations

import base64
import io
import re

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Locator, expect

from fastsplat.service.capture.photos.scene_photos import photo_path
from fastsplat.service.store.blobs.blobs import remove
from fastsplat_contract.photos.pictures import PictureRequest
from tests.web.browser import PHONE, Visit, drawn, visiting
from tests.web.glow import page_view, pixels_of, view_camera
from tests.web.places import Place

_VIEW = "0_-3.2_1.6_0_0_0.2"
_PLACES = {1: (-0.7, 0.0, 0.3), 2: (0.0, 0.3, 0.3), 3: (0.7, -0.1, 0.3)}


def _ready(visit: Visit) -> Locator:
    canvas = visit.scene_shown()
    expect(canvas).to_have_attribute("data-colors", re.compile("."))
    return canvas


def _shot(visit: Visit, box: dict[str, float]) -> NDArray[np.float64]:
    """float64 [H, W, 3]: what the page shows in a rectangle."""
    return pixels_of(drawn(visit.page, box))


def _compared(visit: Visit, share: int) -> NDArray[np.float64]:
    """What is seen of photo and scene with the slider at a share, below the bar."""
    slider = visit.page.get_by_role("slider", name="How much of the picture is photo")
    slider.fill(str(share))
    box, top = _photo_below_bar(visit)
    bottom = min(box["y"] + box["height"], visit.page.viewport_size["height"])
    pixels = _shot(visit, {"x": box["x"], "y": top, "width": box["width"], "height": bottom - top})
    return pixels[2:-2, 2:-2]


def _photo_below_bar(visit: Visit) -> tuple[dict[str, float], float]:
    """The photo's rectangle, and from where on the bar does not cover it."""
    box = visit.page.locator(".compared-photo").evaluate(
        "(image) => { const { x, y, width, height } = image.getBoundingClientRect(); return { x, y, width, height }; }"
    )
    bar = visit.page.locator(".compare-bar").bounding_box()
    return box, max(box["y"], bar["y"] + bar["height"] + 2)


def _at(place: Place, picture: NDArray[np.float64], visit: Visit, view: str) -> NDArray[np.float64]:
    """The server's picture of a view where `_compared` has cut it out."""
    box, top = _photo_below_bar(visit)
    with Image.open(io.BytesIO(place.service.answers.picture(PictureRequest(place.scene_id, "rgb", view=view)))) as png:
        large = png.convert("RGB").resize((round(box["width"]), round(box["height"])), Image.Resampling.BICUBIC)
    pixels = np.asarray(large, dtype=np.float64)[round(top - box["y"]) + 2 :, 2:]
    return pixels[: len(picture), : picture.shape[1]]


def test_a_slider_shows_the_photo_the_scene_or_half_of_each_exactly_over_each_other(
    place: Place, webgl_browser: Browser
) -> None:
    with visiting(webgl_browser, place.url, f"#/scenes/{place.scene_id}", device_scale_factor=1) as visit:
        canvas = _ready(visit)
        visit.tab("Photos").get_by_label("Stand at a photo").select_option("001.jpg")
        expect(visit.page.locator(".compared-photo")).to_have_attribute("data-photo", "001.jpg")
        visit.check_accessible()
        scene, photo, half = (_compared(visit, share) for share in (0, 100, 50))
        truth = _at(place, scene, visit, "001.jpg")
        assert np.abs(scene - truth).mean() < 6  # the scene as the server sees it from that camera
        assert np.abs(photo - truth[..., ::-1]).mean() < 6  # the photo has red and blue exchanged
        assert np.abs(photo - scene).mean() > 10
        middle = photo.shape[1] // 2
        assert np.abs(half[:, : middle - 4] - photo[:, : middle - 4]).mean() < 1
        assert np.abs(half[:, middle + 4 :] - scene[:, middle + 4 :]).mean() < 1
        # They fit: no shift of one against the other fits better.
        gray = [np.roll(photo[..., ::-1].mean(axis=2), shift, axis=(0, 1)) for shift in _SHIFTS]
        errors = [np.abs(scene.mean(axis=2) - shifted)[8:-8, 8:-8].mean() for shifted in gray]
        assert errors.index(min(errors)) == 0, errors

        # By keyboard: the next photo, the one before; whoever moves away leaves it.
        canvas.focus()
        visit.page.keyboard.press("n")
        expect(visit.page.locator(".compare-bar")).to_contain_text("002.jpg")
        visit.page.keyboard.press("p")
        visit.page.keyboard.press("p")
        expect(visit.page.locator(".compare-bar")).to_contain_text("000.jpg")
        expect(visit.page.locator(".compared-photo")).to_have_attribute("data-photo", "000.jpg")
        expect(visit.page).to_have_url(re.compile("look=at%3A000.jpg"))
        visit.page.reload()
        expect(visit.page.locator(".compared-photo")).to_have_attribute("data-photo", "000.jpg")
        visit.page.locator("canvas[role=application]").focus()
        visit.page.keyboard.press("ArrowLeft")
        expect(visit.page.locator(".compare-bar")).to_have_count(0)
        expect(visit.page).not_to_have_url(re.compile("look="))


_SHIFTS = ((0, 0), (0, 3), (0, -3), (3, 0), (-3, 0))


def test_cameras_are_drawn_where_they_are_and_a_click_flies_there(place: Place, webgl_browser: Browser) -> None:
    with visiting(webgl_browser, place.url, f"#/scenes/{place.scene_id}?view=0_-8_5_0_0_0.2") as visit:
        canvas = _ready(visit)
        expect(visit.page.locator(".frusta")).to_have_count(0)
        visit.tab("Photos").get_by_label("Draw the cameras").check()
        expect(visit.page.locator(".frusta [data-camera]")).to_have_count(3)
        expect(visit.page).to_have_url(re.compile("look=cameras"))
        box = canvas.bounding_box()
        seen_from = view_camera(np.array([0, -8, 5, 0, 0, 0.2]), round(box["width"]), round(box["height"]))
        for posed in place.service.get_scene(place.scene_id).cameras:
            x, y = seen_from.pixels(posed.world_from_camera[:3, 3])
            dot = visit.page.locator(f'.frusta [data-camera="{posed.name}"] circle.hit').bounding_box()
            assert abs(dot["x"] + dot["width"] / 2 - box["x"] - x) < 1
            assert abs(dot["y"] + dot["height"] / 2 - box["y"] - y) < 1
        visit.check_accessible()
        visit.page.mouse.click(dot["x"] + dot["width"] / 2, dot["y"] + dot["height"] / 2)
        expect(visit.page.locator(".compared-photo")).to_have_attribute("data-photo", posed.name)
        # The address has the view: the camera's own place.
        expect(visit.page).to_have_url(re.compile(f"at%3A{posed.name}"))
        assert np.allclose(page_view(visit.page)[:3], posed.world_from_camera[:3, 3], atol=1e-3)


def test_colors_say_objects_labels_depth_and_normals(place: Place, webgl_browser: Browser) -> None:
    with visiting(webgl_browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}", device_scale_factor=1) as visit:
        canvas = _ready(visit)
        box = canvas.bounding_box()
        true_colors = _balls(visit, box)
        legend = visit.page.get_by_role("region", name="What the colors mean")
        for mode in ("Depth", "Normals", "Labels", "Objects"):
            visit.page.get_by_label("Colors show").select_option(mode)
            expect(canvas).to_have_attribute("data-colors", mode.lower())
            expect(visit.page).to_have_url(re.compile(f"look={mode.lower()}"))
            colors = _balls(visit, box)
            assert all(np.abs(colors[obj] - true_colors[obj]).max() > 25 for obj in _PLACES), mode
            if mode == "Depth":
                expect(legend).to_contain_text(re.compile(r"\d m.*\d m"))
                # The ball in the middle stands farther away than the two others, which are about as far.
                assert np.abs(colors[2] - colors[3]).sum() > np.abs(colors[1] - colors[3]).sum()
            elif mode == "Normals":
                expect(legend).to_contain_text("x of the scene")
            else:
                _check_legend(legend, colors)
            visit.check_accessible()
        visit.page.reload()  # keeps it
        expect(_ready(visit)).to_have_attribute("data-colors", "objects")


def _check_legend(legend: Locator, colors: dict[int, NDArray[np.float64]]) -> None:
    """Each object has a color of its own, of the hue that the legend says."""
    for obj in _PLACES:
        distances = [np.abs(colors[obj] - colors[other_obj]).max() for other_obj in _PLACES if other_obj != obj]
        assert min(distances) > 60, colors
    swatches = legend.locator(".swatch rect").evaluate_all("(all) => all.map((each) => each.getAttribute('fill'))")
    names = [name.strip() for name in legend.locator("li").all_inner_texts()]
    for obj, label in enumerate(("mug", "ball", "story book"), start=1):
        swatch = np.array([int(part) for part in re.findall(r"\d+", swatches[names.index(label)])], dtype=np.float64)
        seen = colors[obj]
        assert seen @ swatch / np.linalg.norm(seen) / np.linalg.norm(swatch) > 0.98


def _balls(visit: Visit, box: dict[str, float]) -> dict[int, NDArray[np.float64]]:
    """The color in the middle of each ball, by object id."""
    camera = view_camera(np.array([0, -3.2, 1.6, 0, 0, 0.2]), round(box["width"]), round(box["height"]))
    pixels = _shot(visit, box)
    colors = {}
    for obj, middle in _PLACES.items():
        x, y = camera.pixels(np.array(middle))
        colors[obj] = pixels[int(y) - 4 : int(y) + 4, int(x) - 4 : int(x) + 4].mean(axis=(0, 1))
    return colors


def test_an_answer_and_an_object_have_the_photos_that_show_them_best(place: Place, webgl_browser: Browser) -> None:
    best = place.service.photos.best_views(place.scene_id, text="ball").views
    with visiting(webgl_browser, place.url, f"#/scenes/{place.scene_id}?q=ball") as visit:
        _ready(visit)
        photos = visit.page.locator(".ask .best-photos")
        expect(photos).to_contain_text("Photos that show it best")
        expect(photos.get_by_role("button")).to_have_count(len(best))
        names = [button.get_attribute("aria-label") for button in photos.get_by_role("button").all()]
        assert names == [f"Fly to {view.view}" for view in best]
        expect(photos.locator("img.picture")).to_have_count(len(best))
        # The outline lies on the ball's pixels.
        address = photos.locator("img.outline").first.get_attribute("src") or ""
        with Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2]))) as drawn:
            outlined = np.asarray(drawn.getchannel("A")) > 0
        assert (outlined == best[0].mask.array()).all()
        visit.check_accessible()
        photos.get_by_role("button").first.click()
        expect(visit.page.locator(".compared-photo")).to_have_attribute("data-photo", best[0].view)
        visit.tab("Objects").locator(".object-list").get_by_role("button", name="mug").click()
        first = place.service.photos.best_views(place.scene_id, (1,)).views[0].view
        expect(visit.page.locator(".object-card .best-photos button").first).to_have_attribute(
            "aria-label", f"Fly to {first}"
        )


def test_a_scene_without_photos_compares_with_nothing_and_says_so(place: Place, webgl_browser: Browser) -> None:
    scene_id = place.new_scene("old")
    folder = place.service._store.blobs.version(scene_id, place.service.get_scene(scene_id).version)
    remove(photo_path(folder, 0).parent)
    with visiting(webgl_browser, place.url, f"#/scenes/{scene_id}?q=mug", **PHONE) as visit:
        canvas = _ready(visit)
        expect(visit.page.locator(".ask .best-photos")).to_contain_text("Views that show it best")
        expect(visit.page.locator(".ask .best-photos img.picture")).to_have_count(3)  # pictures of the scene itself
        canvas.focus()
        visit.page.keyboard.press("n")
        expect(visit.page.locator(".compare-bar")).to_contain_text("No photo is stored with this scene")
        assert visit.fits()
        visit.check_accessible()
