"""Laws of the sheet of tags: what is printed has the size that the server reckons with."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.capture.world.scale_tags import find_tags
from fastsplat.service.capture.world.tag_sheet import A4_MM, pixels_per_mm, tag_pages
from fastsplat_contract.errors import InvalidInputError
from tests.commands import invoke


@pytest.mark.parametrize("side_m", [0.03, 0.08, 0.15])
def test_tags_on_the_page_have_their_side_and_are_all_there(side_m: float) -> None:
    tags, numbers = range(560, 569), []
    for page in tag_pages(tags, side_m):
        np.testing.assert_allclose(np.array(page.shape[::-1]) / pixels_per_mm(side_m), A4_MM, atol=0.1)
        step = max(1, page.shape[0] // 1500)
        for sighting in find_tags(np.ascontiguousarray(page[::step, ::step]), 0, tags):
            numbers.append(sighting.tag)
            sides = np.linalg.norm(sighting.corners - np.roll(sighting.corners, 1, axis=0), axis=1)
            np.testing.assert_allclose(sides * step / pixels_per_mm(side_m) / 1e3, side_m, rtol=0.01)
    assert sorted(numbers) == list(tags)


def test_the_command_writes_a4_pages_with_the_servers_side(tmp_path: Path) -> None:
    result = invoke("tags", str(tmp_path / "tags.pdf"), "--count", "5")
    assert result.exit_code == 0, result.output
    assert "5 tags of 80 mm on 2 pages" in result.output
    boxes = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", (tmp_path / "tags.pdf").read_bytes())
    assert len(boxes) == 2
    np.testing.assert_allclose(np.array(boxes, float), [np.array(A4_MM) / 25.4 * 72] * 2, atol=0.5)


def test_a_side_that_the_server_does_not_expect_is_said(tmp_path: Path) -> None:
    result = invoke("tags", str(tmp_path / "tags.pdf"), "--side-mm", "50")
    assert "FASTSPLAT_CAPTURE__TAG_SIDE_M=0.05" in result.output


@pytest.mark.parametrize(
    ("tags", "side_m", "field"),
    [([1], 0.3, "side_mm"), ([1], 0.001, "side_mm"), ([587], 0.08, "tags"), ([], 0.08, "tags"), ([3, 3], 0.08, "tags")],
)
def test_what_cannot_be_printed_is_refused(tags: list[int], side_m: float, field: str) -> None:
    with pytest.raises(InvalidInputError) as caught:
        tag_pages(tags, side_m)
    assert caught.value.field == field and caught.value.limit
