"""When photos were taken stays with a scene: from their EXIF to its quality, unless nothing of them is to stay."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import ExifTags, Image

from fastsplat.service.capture.capture_settings import PhotoSettings
from fastsplat.service.capture.captures import Capture, WithheldReport
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.jobs.create_scene import build_scene, capture_folder
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import TAKEN_AT
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


def _quality(capture: Capture, tmp_path: Path, photos: PhotoSettings) -> Mapping[str, Any]:
    write_words(tmp_path / "models")
    settings = Settings(
        models=tmp_path / "models",
        perception=PerceptionSettings(text_encoder=ENCODER),
        training=TrainingSettings(iterations=5, time_budget_s=None, max_gaussians=500, held_out_every=0),
        photos=photos,
    )
    maps = tuple(np.ones((view.posed.camera.height, view.posed.camera.width), np.uint16) for view in capture.views)
    return build_scene(capture, settings, labelling=Labelling(dictionary_of(["mug"]), maps, exact=True)).scene.quality


def test_times_with_their_zone_stay_with_the_scene(capture: Capture, tmp_path: Path) -> None:
    times = {view.posed.name: view.taken_at for view in capture.views if view.taken_at is not None}
    assert times == {capture.views[1].posed.name: _TAKEN}
    assert _quality(capture, tmp_path, PhotoSettings())[TAKEN_AT] == times


def test_no_time_stays_where_photos_do_not_or_people_are_withheld(capture: Capture, tmp_path: Path) -> None:
    assert TAKEN_AT not in _quality(capture, tmp_path / "off", PhotoSettings(keep="off"))
    private = replace(capture, report=replace(capture.report, withheld=WithheldReport("people", 0, 0.0)))
    assert TAKEN_AT not in _quality(private, tmp_path / "private", PhotoSettings())
    movers = replace(capture, report=replace(capture.report, withheld=WithheldReport(None, 0, 0.0)))
    assert TAKEN_AT in _quality(movers, tmp_path / "movers", PhotoSettings())
