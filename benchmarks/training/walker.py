"""A walker in 40 % of the training photos of a posed data set with depth maps: what he costs, and what masks save.

    python -m benchmarks.training.walker DATA [--split test] [--steps 400] [--side 240] [--out benchmarks/results]

DATA is a folder as `benchmarks.training` takes it, whose frames have `depth_path` (16-bit PNG, 1e-4 m, planar z) and
whose document has `split`. A drawn figure, upright in the world and turned to the camera, stands at another place in
each of his photos; what lies in front of it by the depth maps hides it. Every variant has the same steps, so that a
busy machine changes nothing. `psnr` is of photos that are held out (of the training split by default, the test photos
with `--split test`), which show the empty room; `psnr_behind` of what he hides in the photos that he is in, compared
with the photos of the empty room: what a ghost of him costs.

`person_seen` is the detector's word (FASTSPLAT_MODELS, the default closed-set detector with the service's settings): in
how many pictures it sees a person at the score from which people are withheld, and its highest score there; of the
photos themselves, and of every variant as it is rendered in the test views and in the views that he was in, where a
ghost of him would stand; `where_he_was` counts the pictures in which a box covers that place. How many of his own
photos it recognizes him in says what that word is worth.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from benchmarks.provenance import RESULTS, begin, chosen_on, provenance, write_json
from benchmarks.splits import Split, add_split, results_file, with_split
from benchmarks.trade.bench_captures import models
from benchmarks.training.posed_folder import load_posed_folder
from fastsplat.service.capture.image_io import load_rgb
from fastsplat.service.capture.types import Capture, View
from fastsplat.service.capture.withholding import Withholding
from fastsplat.service.common.dictionary import Dictionary, label_key
from fastsplat.service.common.progress import silent
from fastsplat.service.perception.capture_detection import detect_closed_set
from fastsplat.service.perception.detectors.open_detectors import open_closed_set_detector
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.types import ClosedSetDetector, Labelling
from fastsplat.service.scene.types import Gaussians
from fastsplat.service.splatting.gaussians import color_parameters, splats_of
from fastsplat.service.splatting.objective import render_frame
from fastsplat.service.splatting.quality import measure_views
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.train import train
from fastsplat.service.splatting.training_views import TrainingView, load_views

_SHARE = 0.4
_LEAST_SHARE = 0.06
"""Of a photo; a place where less of him is to be seen is drawn again, at most `_DRAWS` times."""
_DRAWS = 40
_SIZE_M = (0.45, 1.3)
_FOOT_M = -0.25
"""Height of his feet; the table's top is 0."""
_HIS_SHARE = 0.1
"""Of a detector's box: from here on it is of him."""


def figure() -> NDArray[np.uint8]:
    """uint8 [300, 100, 4] RGBA: head, striped shirt, trousers, legs apart."""
    image = Image.new("RGBA", (100, 300), (0, 0, 0, 0))
    draw = ImageDraw.Draw(image)
    draw.polygon([(28, 160), (72, 160), (92, 298), (70, 298), (50, 200), (30, 298), (8, 298)], fill=(44, 52, 92, 255))
    draw.rounded_rectangle((18, 58, 82, 172), 16, fill=(190, 60, 44, 255))
    for y in range(66, 168, 16):
        draw.rectangle((18, y, 82, y + 6), fill=(236, 226, 205, 255))
    draw.rectangle((4, 66, 18, 150), fill=(176, 52, 40, 255))
    draw.rectangle((82, 66, 96, 150), fill=(176, 52, 40, 255))
    draw.ellipse((32, 4, 68, 56), fill=(224, 172, 138, 255))
    draw.chord((30, 0, 70, 44), 170, 370, fill=(52, 36, 26, 255))
    return np.asarray(image)


def with_walker(
    view: View, pixels: NDArray[np.uint8], depth: NDArray[np.float32], place: NDArray[np.float64]
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """The photo with the figure standing at `place` (x, y of the world, z up), and where it is to be seen, bool [H, W].

    Args:
        view: its camera.
        pixels: uint8 [H, W, 3].
        depth: float32 [H, W], planar z in the world's unit.
        place: float64 [2].
    """
    camera = view.posed.camera
    center = view.posed.world_from_camera[:3, 3]
    toward = np.append(center[:2] - place, 0.0)
    toward /= np.linalg.norm(toward)
    right = np.array([-toward[1], toward[0], 0.0])
    origin = np.array([*place, _FOOT_M])
    height, width = depth.shape
    rows, columns = np.mgrid[0:height, 0:width]
    directions = camera.rays(columns + 0.5, rows + 0.5) @ view.posed.world_from_camera[:3, :3].T
    z = ((origin - center) @ toward) / (directions @ toward)  # along rays of planar depth 1
    hits = center + directions * z[..., None]
    across = ((hits - origin) @ right) / _SIZE_M[0] + 0.5
    up = (hits[..., 2] - _FOOT_M) / _SIZE_M[1]
    art = figure()
    inside = (z > 0) & (across >= 0) & (across < 1) & (up >= 0) & (up < 1)
    u = np.where(inside, across * art.shape[1], 0).astype(int)
    v = np.where(inside, (1 - up) * art.shape[0], 0).astype(int).clip(0, art.shape[0] - 1)
    shown = inside & (art[v, u, 3] > 0) & (z < depth)
    return np.where(shown[..., None], art[v, u, :3], pixels), shown


def crossed(
    folder: Path, capture: Capture, training: tuple[str, ...], out: Path, seed: int = 0
) -> tuple[Capture, Capture, dict[str, float]]:
    """The capture with the walker in `_SHARE` of its training photos, the same with masks of him, and his share of each
    photo."""
    rng = np.random.default_rng(seed)
    walked = set(rng.choice(training, round(_SHARE * len(training)), replace=False))
    views, masked, shares = [], [], {}
    document = json.loads((folder / "transforms.json").read_text())
    depth_of = {Path(frame["file_path"]).name: folder / frame["depth_path"] for frame in document["frames"]}
    for view in capture.views:
        name = view.posed.name
        if Path(name).stem not in walked:
            views.append(view)
            masked.append(view)
            continue
        pixels = np.asarray(Image.open(view.image_path).convert("RGB"))
        depth = np.asarray(Image.open(depth_of[name])).astype(np.float32) * 1e-4
        empty = pixels
        for _ in range(_DRAWS):
            place = np.array([rng.uniform(-0.9, 0.9), rng.uniform(0.1, 0.7)])
            pixels, shown = with_walker(view, empty, depth, place)
            if shown.mean() >= _LEAST_SHARE:
                break
        Image.fromarray(shown.astype(np.uint8) * 255).save(out / f"{Path(name).stem}_shown.png")
        path = out / f"{Path(name).stem}.png"
        Image.fromarray(pixels).save(path)
        usable = Withholding(lambda _, shown=shown: shown).apply(pixels).usable
        valid = None
        if usable is not None:
            valid = out / f"{Path(name).stem}_usable.png"
            Image.fromarray(usable.astype(np.uint8) * 255).save(valid)
        shares[name] = round(float(shown.mean()), 4)
        views.append(replace(view, image_path=path))
        masked.append(replace(view, image_path=path, valid_path=valid))
    return replace(capture, views=tuple(views)), replace(capture, views=tuple(masked)), shares


def _hidden(empty: Capture, folder: Path, side: int) -> tuple[TrainingView, ...]:
    """The empty room's photos of the crossed views, of which only what he hides is valid."""
    views = []
    for view in empty.views:
        shown = folder / f"{Path(view.posed.name).stem}_shown.png"
        if shown.is_file():
            views.append(replace(view, valid_path=shown))
    capture = replace(empty, views=tuple(views))
    return load_views(capture, Labelling(Dictionary(()), ()), tuple(range(len(views))), side, (1.0,))


def person_seen(
    detector: ClosedSetDetector,
    settings: PerceptionSettings,
    pictures: Iterable[tuple[NDArray[np.uint8], NDArray[np.bool_] | None]],
) -> dict[str, float]:
    """How many pictures there are, how many show a person by the detector's word, in how many of these a box covers him
    rather than something else, and the highest score (0: none).

    Args:
        detector, settings: of the service.
        pictures: uint8 [H, W, 3], and bool [H, W] where he stood when the photo was taken, None in views without him.
    """
    words = {label_key(word) for word in settings.people_words}
    count, seen, covered, highest = 0, 0, 0, 0.0
    for picture, place in pictures:
        detected = detect_closed_set(detector, picture, settings)
        people = detected.take([row for row, label in enumerate(detected.labels) if label_key(label) in words])
        shares = [] if place is None else [_share_inside(box, place) for box in people.boxes]
        count, seen, covered = count + 1, seen + bool(len(people)), covered + any(x >= _HIS_SHARE for x in shares)
        highest = max(highest, *map(float, people.scores), 0.0)
    return {"pictures": count, "with_person": seen, "where_he_was": covered, "highest": round(highest, 3)}


def _share_inside(box: NDArray[np.float32], place: NDArray[np.bool_]) -> float:
    left, top, right, bottom = (round(float(value)) for value in box)
    inside = place[max(top, 0) : bottom, max(left, 0) : right]
    return float(inside.mean()) if inside.size else 0.0


def _rendered(
    gaussians: Gaussians, capture: Capture, names: Collection[str], work: Path
) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.bool_] | None]]:
    """The named views of a scene at the size of their photos, and where he stood in them."""
    parameters = color_parameters(gaussians)
    splats = splats_of(parameters)
    indices = tuple(index for index, view in enumerate(capture.views) if view.posed.name in names)
    for view in load_views(capture, Labelling(Dictionary(()), ()), indices, 1_000_000, (1.0,)):
        drawn = render_frame(parameters, splats, view, view.frames[-1], degree=gaussians.sh_degree, backend="cpu")
        yield (drawn.image.clamp(0, 1) * 255).round().byte().numpy(), _place(view.name, work)


def _photos(
    capture: Capture, names: Collection[str], work: Path
) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.bool_] | None]]:
    for view in capture.views:
        if view.posed.name in names:
            yield load_rgb(view.image_path), _place(view.posed.name, work)


def _place(name: str, work: Path) -> NDArray[np.bool_] | None:
    path = work / f"{Path(name).stem}_shown.png"
    return np.asarray(Image.open(path)) > 0 if path.is_file() else None


def loaded(folder: Path, split: Split) -> tuple[Capture, tuple[str, ...]]:
    """The capture, its photos to be measured set apart, and the stems of those to train on."""
    capture, _ = load_posed_folder(folder)
    capture, _ = with_split(capture, Labelling(Dictionary(()), ()), capture.test_names, split)
    names = (view.posed.name for view in capture.views)
    return capture, tuple(Path(name).stem for name in names if name not in capture.test_names)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--side", type=int, default=240)
    parser.add_argument("--gaussians", type=int, default=20_000)
    parser.add_argument("--only", nargs="*", default=[], help="names of variants")
    parser.add_argument("--out", type=Path, default=RESULTS)
    add_split(parser)
    options = parser.parse_args()
    settings = TrainingSettings(
        iterations=options.steps,
        time_budget_s=None,
        max_side=options.side,
        max_gaussians=options.gaussians,
        evaluations=0,
    )
    start = begin()
    perception = PerceptionSettings()
    detector = open_closed_set_detector(perception, models())
    with tempfile.TemporaryDirectory() as work:
        empty, training = loaded(options.data, options.split)
        walked, masked, shares = crossed(options.data, empty, training, Path(work))
        hidden = _hidden(empty, Path(work), options.side)
        variants = {
            "empty room": empty,
            "walker, untreated": walked,
            "walker, masks known": masked,
        }
        photos = {
            name: person_seen(detector, perception, _photos(capture, shares, Path(work)))
            for name, capture in (("walker's photos", walked), ("the same, empty room", empty))
        }
        print("photos", photos, flush=True)
        rows: dict[str, dict[str, Any]] = {}
        for name, capture in variants.items():
            if options.only and name not in options.only:
                continue
            trained = train(capture, Labelling(Dictionary(()), ()), settings, silent)
            rows[name] = {key: round(trained.quality[key], 4) for key in ("psnr", "ssim", "gaussians")}
            behind = measure_views(color_parameters(trained.gaussians), hidden, settings.backend)
            rows[name] |= {f"{key}_behind": round(value, 4) for key, value in behind.items()}
            rows[name]["person_seen"] = {
                where: person_seen(detector, perception, _rendered(trained.gaussians, empty, names, Path(work)))
                for where, names in (("test views", empty.test_names), ("his views", tuple(shares)))
            }
            print(name, rows[name], flush=True)
    document = {
        "data": options.data.resolve().name,
        **provenance(start, settings=options, chosen_on=chosen_on(options.data.resolve().name, options.split)),
        "steps": options.steps,
        "walker_share": shares,
        "detector": perception.closed_set_detector,
        "person_seen_in_photos": photos,
        "variants": rows,
    }
    write_json(options.out / results_file("walker", options.split).name, document)


if __name__ == "__main__":
    main()
