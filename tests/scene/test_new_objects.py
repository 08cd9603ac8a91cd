"""One more object: whose Gaussians it takes, and that everything else stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.scene.artefact.scene import Object, ObjectGroup, Objects, Scene
from fastsplat.service.scene.objects.label_evidence import evidence_of, posterior
from fastsplat.service.scene.objects.new_objects import with_new_object
from fastsplat.service.scene.objects.objects import MAX_OBJECT_ID, object_rows
from fastsplat_contract.errors import LimitExceededError
from tests.scenes import labelled_scene

_COUNT = 12


def _scene(seed: int) -> Scene:
    """Gaussians that nobody has seen, that are of no object, of one of four, and of several with different shares."""
    rng = np.random.default_rng(seed)
    rows, labels = np.nonzero(rng.uniform(size=(_COUNT, 5)) < 0.4)
    counts = rng.integers(1, 9, len(rows)).astype(np.int64) * 4096
    scene = labelled_scene(rng.normal(size=(_COUNT, 3)), np.zeros(_COUNT, int), ["x"])
    table = tuple(Object(number) for number in (1, 2, 3, 4))
    groups = (ObjectGroup(5, (1, 2), 0.5), ObjectGroup(7, (2, 3, 4), 0.5))
    return replace(scene, objects=Objects(table, evidence_of(rows, labels, counts, _COUNT), 9, groups=groups))


@given(st.integers(0, 10_000), st.sets(st.integers(0, _COUNT - 1), min_size=1))
def test_the_new_object_has_just_these_gaussians_and_nothing_else_changes(seed: int, rows: set[int]) -> None:
    scene = _scene(seed)
    grown, new_id = with_new_object(scene, np.array(sorted(rows)))
    assert new_id == 9 and grown.objects.next_id == 10 and grown.objects.table == (*scene.objects.table, Object(9))
    before, after = object_rows(scene.objects), object_rows(grown.objects)
    taken = np.isin(np.arange(_COUNT), sorted(rows))
    assert (after[taken] == 9).all()
    np.testing.assert_array_equal(after[~taken], before[~taken])
    for old, new in zip(scene.objects.groups, grown.objects.groups, strict=True):
        assert new == replace(old, members=(*old.members, *([9] if np.isin(before[taken], old.members).all() else [])))
    # The new object is as probable as the one whose place it takes, and the others are as probable as they were.
    old_shares, new_shares = (posterior(objects.membership, 10) for objects in (scene.objects, grown.objects))
    for row in range(_COUNT):
        shares, now = _shares(old_shares, row), _shares(new_shares, row)
        if row in rows and shares:
            shares[9] = shares.pop(int(before[row]))
        assert (now == pytest.approx(shares, abs=1e-3)) if shares else (set(now) == ({9} if row in rows else set()))


def test_there_is_an_end_to_ids() -> None:
    scene = _scene(0)
    full = replace(scene, objects=replace(scene.objects, next_id=MAX_OBJECT_ID))
    last, new_id = with_new_object(full, np.array([0]))
    assert new_id == MAX_OBJECT_ID
    with pytest.raises(LimitExceededError):
        with_new_object(last, np.array([1]))


def _shares(mean: object, row: int) -> dict[int, float]:
    start, end = mean.starts[row], mean.starts[row + 1]
    return dict(zip(mean.labels[start:end].tolist(), mean.probability[start:end].tolist(), strict=True))
