"""When photos were taken stays with a scene: from their EXIF to its quality, unless nothing of them is to stay."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from fastsplat.service.capture.capture_settings import PhotoSettings
from fastsplat.service.capture.captures import Capture, WithheldReport
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.jobs.create_scene import build_scene, capture_folder
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_settings import TrainingSettings
from tests.api.made_scene import ENCODER, write_words

_SAMPLE = Path(__file__).resolve().parents[2] / "demo" / "sample"
_TAKEN = datetime(2026, 3, 4, 11, 30, 15, tzinfo=UTC).timestamp()


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """Four posed photos, of which the second says when it was taken, the third without a zone."""
    folder = tmp_path_factory.mktemp("times") / "photos"
    (folder / "images").mkdir(parents=True)
    document = json.loads((_SAMPLE / "transforms.json").read_text())
    posed = {key: value for key, value in document.items() if key not in ("labels", "split")}
    posed["frames"] = [
        {key: frame[key] for key in ("file_path", "transform_matrix")} for frame in document["frames"][:4]
    ]
    for number, frame in enumerate(posed["frames"]):
        exif = Image.Exif()
        if number in (1, 2):
            detail = exif.get_ifd(ExifTags.IFD.Exif)
            detail[ExifTags.Base.DateTimeOriginal] = "2026:03:04 12:30:15"
            if number == 1:
                detail[ExifTags.Base.OffsetTimeOriginal] = "+01:00"
        Image.open(_SAMPLE / frame["file_path"]).save(folder / frame["file_path"], exif=exif, quality=95)
    (folder / "transforms.json").write_text(json.dumps(posed))
    return capture_folder(folder, folder.parent / "capture", Settings().capture)


def _times(capture: Capture, tmp_path: Path, photos: PhotoSettings) -> Mapping[str, float] | None:
    write_words(tmp_path / "models")
    settings = Settings(
        models=tmp_path / "models",
        perception=PerceptionSettings(text_encoder=ENCODER),
        training=TrainingSettings(iterations=5, time_budget_s=None, max_gaussians=500, held_out_every=0),
        photos=photos,
    )
    maps = tuple(np.ones((view.posed.camera.height, view.posed.camera.width), np.uint16) for view in capture.views)
    labelling = Labelling(dictionary_of(["mug"]), maps, exact=True)
    return build_scene(capture, settings, labelling=labelling).scene.facts.taken_at


def test_times_with_their_zone_stay_with_the_scene(capture: Capture, tmp_path: Path) -> None:
    times = {view.posed.name: view.taken_at for view in capture.views if view.taken_at is not None}
    assert times == {capture.views[1].posed.name: _TAKEN}
    assert _times(capture, tmp_path, PhotoSettings()) == times


def test_no_time_stays_where_photos_do_not_or_people_are_withheld(capture: Capture, tmp_path: Path) -> None:
    assert _times(capture, tmp_path / "off", PhotoSettings(keep="off")) is None
    private = replace(capture, report=replace(capture.report, withheld=WithheldReport("people", 0, 0.0)))
    assert _times(private, tmp_path / "private", PhotoSettings()) is None
    movers = replace(capture, report=replace(capture.report, withheld=WithheldReport(None, 0, 0.0)))
    assert _times(movers, tmp_path / "movers", PhotoSettings())
