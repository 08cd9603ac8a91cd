"""Which octaves of images have their features looked for."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from fastsplat.service.capture.sfm import features

_ENOUGH = 150
_SIDE = 320


@pytest.mark.parametrize("names", ["rich 0, rich 1, plain 2, rich 3", "plain 0, plain 1, rich 2", "plain 0, rich 1"])
def test_the_finest_octave_is_left_out_where_others_give_enough_features(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, names: str
) -> None:
    files = [f"{name}.png" for name in names.split(", ")]
    for file in files:
        cv2.imwrite(str(tmp_path / file), _picture(file))
    looked: list[tuple[int, str]] = []
    extract = pycolmap.extract_features

    def watched(*arguments, **options) -> None:
        looked.extend((options["extraction_options"].sift.first_octave, file) for file in options["image_names"])
        extract(*arguments, **options)

    monkeypatch.setattr(pycolmap, "extract_features", watched)
    found = _features(tmp_path, files, tmp_path / "features.db", features.extract_features)
    alone = _features(tmp_path, files, tmp_path / "alone.db", features._extract)
    seen = set(looked[: -len(files)])
    assert len(seen) == len(looked) - len(files)  # nothing twice
    for file in files:
        assert min(len(found[file]), _ENOUGH) == min(len(alone[file]), _ENOUGH)
        if "plain" in file or (-1, file) in seen:  # as if no other octave had been tried
            assert len(found[file]) > 5 and np.array_equal(found[file], alone[file])
    assert {file for octave, file in seen if octave == 0} == set(files[:2] if files[1].startswith("plain") else files)
    fine = {file for octave, file in seen if octave == -1}
    assert fine == (set(files) if files[1].startswith("plain") else {file for file in files if "plain" in file})


def _picture(name: str) -> np.ndarray:
    """uint8 [side, side]: many blots, or few."""
    rng, picture = np.random.default_rng(len(name) + ord(name[-5])), np.full((_SIDE, _SIDE), 128, np.uint8)
    for _ in range(2_000 if "rich" in name else 12):
        at, radius = rng.integers(0, _SIDE, 2).tolist(), int(rng.integers(1, 9))
        cv2.circle(picture, at, radius, int(rng.integers(0, 256)), -1, cv2.LINE_AA)
    return picture


def _features(images: Path, files: list[str], database: Path, extract) -> dict[str, np.ndarray]:
    """float32 [F, 6] of files."""
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads, options.sift.max_num_features = 1, _ENOUGH
    options.sift.first_octave = 0 if extract is features.extract_features else -1
    pycolmap.Database.open(database).close()
    extract(database, images, files, None, options)
    assert options.sift.first_octave == (0 if extract is features.extract_features and "rich" in files[1] else -1)
    with pycolmap.Database.open(database) as reader:
        return {image.name: np.asarray(reader.read_keypoints(image.image_id)) for image in reader.read_all_images()}
