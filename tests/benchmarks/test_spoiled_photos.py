"""Whatever is wrong with some photos of a capture costs these photos: all others have a place, and each is named."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.robustness.spoiled_photos import DAMAGED, SETTINGS, SPOILED, capture_of
from fastsplat.service.capture.captures import Capture

_GOOD = range(0, 40, 3)


def _capture(folder: Path, names: list[str], test_data: Path) -> Capture:
    """Of fourteen good photos and those with these faults; files that are damaged were whole when they were checked."""
    sent = {f"{index:03d}.jpg": (test_data / f"tabletop/images/{index:03d}.jpg").read_bytes() for index in _GOOD}
    photos, damaged, rng = list(sent.values()), {}, np.random.default_rng(0)
    foreign = np.asarray(Image.open(test_data / "kitchen/images/05.jpg").convert("RGB"))
    for number, name in enumerate(names):
        content = photos[3 * number % len(photos)]
        if name in DAMAGED:
            damaged[f"{name}.jpg"] = DAMAGED[name](content)
        else:
            content = SPOILED[name](np.asarray(Image.open(io.BytesIO(content))), foreign, rng)
        sent[f"{name}.jpg"] = content
    return capture_of(folder, sent, damaged, SETTINGS)


@pytest.mark.parametrize(
    "names",
    [
        ["truncated", "black", "tiny", "foreign", "lying", "crop"],
        ["garbage", "text", "white", "duplicate", "rotated", "lens", "absurd", "huge"],
    ],
    ids=lambda names: names[0],
)
def test_spoiled_photos_cost_themselves_and_are_named(names: list[str], test_data: Path, tmp_path: Path) -> None:
    capture = _capture(tmp_path, names, test_data)
    good, spoiled = {f"{index:03d}.jpg" for index in _GOOD}, {f"{name}.jpg" for name in names}
    placed = {view.posed.name for view in capture.views}
    assert good <= placed <= good | spoiled
    report = capture.report
    verdicts = {verdict.name: verdict for verdict in report.photos}
    assert verdicts.keys() == good | spoiled and report.images == len(verdicts)
    assert set(report.unregistered) == verdicts.keys() - placed
    for name in spoiled - placed:
        assert verdicts[name].not_placed is not None and verdicts[name].advice.endswith(".")
    for name in good:
        assert verdicts[name].placed and set(verdicts[name].defects) <= {"duplicate"}  # of a spoiled copy
    reasons = {name.removesuffix(".jpg"): verdict.not_placed for name, verdict in verdicts.items()}
    assert {reasons[name] for name in DAMAGED.keys() & set(names)} == {"unreadable"}
    assert {reasons[name] for name in {"black", "white", "tiny"} & set(names)} == {"few_features"}
    assert {reasons[name] for name in {"foreign"} & set(names)} <= {"no_overlap", "few_matches", "other_model"}
    if "duplicate" in names:
        copied = f"{3 * names.index('duplicate') * 3 % 42:03d}.jpg"
        assert verdicts["duplicate.jpg"].duplicate_of == copied or verdicts[copied].duplicate_of == "duplicate.jpg"
