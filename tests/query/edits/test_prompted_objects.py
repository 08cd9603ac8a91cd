"""Objects made of what prompts show, and the views that they are shown in again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.objects.visibility import further_views
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.objects.objects import object_rows
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.object_prompts import ObjectPrompt, Pixel
from fastsplat_contract.messages.scenes import Edit
from tests.query.box_scenes import BoxShell, look, orbit, scene_of
from tests.query.conftest import opened

_BOX = BoxShell("mug", (0.0, 0.0, 0.04), (0.1, 0.1, 0.08))
_FAR = BoxShell("book", (0.4, 0.0, 0.04), (0.1, 0.1, 0.08))
_PROMPT = ObjectPrompt(view="0.jpg", pixels=(Pixel(1, 1),))
_ALL = np.arange(_BOX.count)


@pytest.fixture(scope="module")
def index() -> SceneIndex:
    """Object 1 is a mug, object 2 a book far from it."""
    return opened(scene_of([_BOX, _FAR], orbit()))


def _edit(action: Any, **fields: Any) -> Edit:
    return Edit(action, prompt=_PROMPT, object_ids=(1,) if action == "split" else (), **fields)


def test_all_of_an_object_or_all_but_its_rim_is_no_piece(index: SceneIndex) -> None:
    rng = np.random.default_rng(0)
    for piece in (_ALL, np.sort(rng.permutation(_ALL)[5:])):
        with pytest.raises(InvalidInputError, match="all of object 1") as raised:
            apply_edit(index, _edit("split"), piece=piece)
        assert raised.value.field == "prompt" and raised.value.limit and raised.value.hint
    left = np.flatnonzero(index.scene.gaussians.means[: _BOX.count, 0] < 0)
    objects = apply_edit(index, _edit("split"), piece=left).objects
    assert objects is not None
    np.testing.assert_array_equal(np.flatnonzero(object_rows(objects) == 3), left)


def test_nothing_is_no_object(index: SceneIndex) -> None:
    for action in ("split", "add"):
        with pytest.raises(InvalidInputError, match="no Gaussians"):
            apply_edit(index, _edit(action), piece=np.zeros(0, np.int64))


def test_what_is_an_object_already_is_not_added(index: SceneIndex) -> None:
    with pytest.raises(InvalidInputError, match="object 1 already"):
        apply_edit(index, _edit("add"), piece=_ALL[3:])
    both = np.arange(len(index.scene.gaussians))
    objects = apply_edit(index, _edit("add", name="pair"), piece=both).objects
    assert objects is not None and set(object_rows(objects).tolist()) == {3} and objects.table[-1].name == "pair"


def test_further_views_see_the_object_from_other_sides() -> None:
    scene = scene_of([_BOX, _FAR], [*orbit(16), look((0.0, 0.0, -1.0), (0.0, 0.1, -3.0), "away.jpg")])
    first = scene.cameras[0]
    chosen = further_views(scene, _ALL, first, 3)
    names = [posed.name for posed in chosen]
    assert len(set(names)) == 3 and first.name not in names and "away.jpg" not in names
    sides = np.array([posed.world_from_camera[:3, 3] for posed in (first, *chosen)])
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    apart = np.arccos(np.clip(sides @ sides.T, -1, 1))[np.triu_indices(4, 1)]
    assert apart.min() > 0.3 and further_views(scene, _ALL, first, 0) == ()
