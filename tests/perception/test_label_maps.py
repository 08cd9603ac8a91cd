"""Masks to label maps, label maps to a dictionary, and both to disk."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry, dictionary_of
from fastsplat.service.perception.label_maps.labelling_files import load_labelling, save_labelling
from fastsplat.service.perception.label_maps.vocabulary import (
    build_labelling,
    merge_synonyms,
    name_confidence,
    synonyms,
)
from fastsplat.service.perception.results import Detections, Labelling, Regions, ViewMasks
from fastsplat.service.perception.segmenters.mask_postprocessing import clean_mask, paint, resolve_overlaps
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat_contract.errors import InvalidInputError

_mask_stacks = hnp.arrays(np.bool_, st.tuples(st.integers(1, 4), st.just(6), st.just(7)))
_maps = st.lists(hnp.arrays(np.uint16, (5, 6), elements=st.integers(0, 3)), min_size=1, max_size=4)


@given(_mask_stacks)
def test_a_pixel_belongs_to_its_smallest_mask(masks: np.ndarray) -> None:
    ids = list(range(1, len(masks) + 1))
    label_map = paint(masks, ids, np.ones(len(masks), np.float32))
    areas = masks.sum((1, 2))
    assert ((label_map == 0) == ~masks.any(0)).all()
    for row, column in np.argwhere(label_map > 0):
        covering = [i for i in range(len(masks)) if masks[i, row, column]]
        assert areas[label_map[row, column] - 1] == min(areas[i] for i in covering)


def test_equal_masks_go_to_the_heavier() -> None:
    masks = np.ones((2, 3, 3), np.bool_)
    assert (paint(masks, [1, 2], np.array([0.9, 0.2], np.float32)) == 1).all()
    assert (paint(masks, [1, 2], np.array([0.2, 0.9], np.float32)) == 2).all()


def test_two_names_for_the_same_pixels_leave_one() -> None:
    doll, almost, bed = np.zeros((3, 20, 20), np.bool_)
    doll[5:15, 5:15] = almost[5:15, 6:15] = True
    bed[:] = True
    stack = np.stack([doll, almost, bed])
    weights = np.array([0.5, 0.8, 0.3], np.float32)
    assert resolve_overlaps(stack, ["cake", "doll", "bed"], weights, 0.7) == [1, 2]
    assert resolve_overlaps(stack, ["doll", "doll", "bed"], weights, 0.7) == [0, 1, 2]


def test_specks_and_pinholes_go_and_the_object_stays() -> None:
    mask = np.zeros((60, 60), np.bool_)
    mask[10:50, 10:50] = True
    expected = mask.copy()
    mask[30, 30] = False
    mask[2, 2] = True
    np.testing.assert_array_equal(clean_mask(mask), expected)
    for same in (np.zeros_like(mask), np.ones_like(mask)):
        np.testing.assert_array_equal(clean_mask(same), same)


@given(_maps)
def test_the_finished_dictionary_counts_its_maps(maps: list[np.ndarray]) -> None:
    labelling = build_labelling(["cup", "bed", "doll"], maps, {}, min_pixels=1)
    pixels = [entry.pixels for entry in labelling.dictionary.entries]
    assert pixels == sorted(pixels, reverse=True)
    assert sum(pixels) == sum(int((m > 0).sum()) for m in maps)
    for old, kind in enumerate(["cup", "bed", "doll"], start=1):
        new = labelling.dictionary.id_of(kind)
        for before, after in zip(maps, labelling.label_maps, strict=True):
            np.testing.assert_array_equal(before == old, after == new if new else np.zeros_like(before, np.bool_))
        if new:
            assert labelling.dictionary.entries[new - 1].views == sum(bool((m == old).any()) for m in maps)


def test_kinds_with_few_pixels_become_undetected() -> None:
    maps = [np.array([[1, 1, 1, 2]], np.uint16), np.array([[0, 0, 0, 2]], np.uint16)]
    labelling = build_labelling(["bed", "dust"], maps, {}, min_pixels=2)
    assert [entry.label for entry in labelling.dictionary.entries] == ["bed"]
    np.testing.assert_array_equal(np.stack(labelling.label_maps), [[[1, 1, 1, 0]], [[0, 0, 0, 0]]])


def test_a_name_that_was_asked_for_stays_while_a_region_is_called_so() -> None:
    ids = np.array([[1, 1, 2]], np.uint16)
    regions = [Regions(ids, (((1, 0.5), (3, 0.4)), ((2, 0.5),)))]
    for expected, names in ((False, ["cup", "bed"]), (True, ["cup", "bed", "mug"])):
        classes = ["cup", "bed", "mug", "pan"]
        labelling = build_labelling(classes, [ids], {}, min_pixels=1, regions=regions, expected=expected)
        assert [entry.label for entry in labelling.dictionary.entries] == names
        numbers = {name: labelling.dictionary.id_of(name) for name in names}
        votes = [(numbers["cup"], 0.5)] + ([(numbers["mug"], 0.4)] if expected else [])
        assert labelling.regions[0].votes == (tuple(votes), ((numbers["bed"], 0.5),))


def _region(label: int, *votes: tuple[int, float]) -> tuple[np.ndarray, Regions]:
    """A view of one region: its label map, and its votes."""
    return np.array([[0, label]], np.uint16), Regions(np.array([[0, 1]], np.uint16), (votes,))


def _confidence(*views: tuple[np.ndarray, Regions], classes: int = 2) -> list[float]:
    return name_confidence([view[0] for view in views], [view[1] for view in views], classes).tolist()


def test_a_name_seen_once_is_as_sure_as_its_score() -> None:
    nothing = np.zeros((1, 2), np.uint16), Regions(np.zeros((1, 2), np.uint16), ())
    assert _confidence(_region(1, (1, 0.3)), *[nothing] * 25) == pytest.approx([0.3, 0.0])


def test_views_that_agree_make_a_name_sure_and_rivals_make_it_doubtful() -> None:
    alone = _confidence(*[_region(1, (1, 0.8))] * 10)
    rivals = _confidence(*[_region(1, (1, 0.6), (2, 0.4))] * 30)
    assert alone == pytest.approx([1.0, 0.0], abs=1e-6)
    assert rivals == pytest.approx([0.6, 0.4], abs=1e-6)


def test_votes_elsewhere_do_not_count_against_a_name_that_has_regions_of_its_own() -> None:
    first, second = _region(1, (1, 0.9)), _region(2, (2, 0.9), (1, 0.3))
    sure = _confidence(*[first] * 5, *[second] * 5)
    assert sure[0] == pytest.approx(1.0, abs=1e-4) and sure[1] == pytest.approx(0.75, abs=1e-4)


@given(
    st.lists(st.lists(st.tuples(st.integers(1, 3), st.floats(0, 1)), max_size=3, unique_by=lambda v: v[0]), max_size=5)
)
def test_a_confidence_is_a_probability_and_another_view_of_the_name_alone_never_lowers_it(
    views: list[list[tuple[int, float]]],
) -> None:
    regions = [_region(votes[0][0] if votes else 0, *votes) for votes in views]
    before = _confidence(*regions, classes=3)
    after = _confidence(*regions, _region(2, (2, 0.5)), classes=3)
    assert all(0 <= value <= 1 for value in before)
    assert after[0] == before[0] and after[2] == before[2]
    if any(votes and votes[0][0] == 2 for votes in views):
        assert after[1] >= before[1] - 1e-12


def test_the_confidence_of_votes_reaches_the_dictionary() -> None:
    maps, regions = zip(_region(2, (2, 0.25)), _region(1, (1, 0.75)), strict=True)
    labelling = build_labelling(["cup", "bed"], maps, {}, min_pixels=1, regions=regions)
    assert {entry.label: entry.confidence for entry in labelling.dictionary.entries} == {"cup": 0.75, "bed": 0.25}


def _detections(*rows: tuple[str, tuple[float, ...]]) -> Detections:
    boxes = np.array([box for _, box in rows], np.float32)
    return Detections(boxes, np.full(len(rows), 0.8, np.float32), tuple(name for name, _ in rows))


def test_synonyms_need_both_meaning_and_place(models_dir: Path) -> None:
    encoder = open_text_encoder("minilm_l6_int8", models_dir, threads=2)
    here, there = (0, 0, 50, 50), (100, 100, 150, 150)
    together = _detections(("couch", here), ("sofa", (1, 0, 50, 50)), ("bed", (0, 0, 50, 49)))
    apart = _detections(("couch", here), ("sofa", there))
    rule = {"cosine": 0.8, "iou": 0.5}
    assert synonyms([together, _detections(("couch", here))], encoder, **rule) == {"sofa": "couch"}
    assert synonyms([together, _detections(("sofa", here))], encoder, **rule) == {"couch": "sofa"}
    assert synonyms([apart], encoder, **rule) == {}
    assert synonyms([together], encoder, cosine=0.999, iou=0.5) == {}
    merged = merge_synonyms([together], {"sofa": "couch"})
    assert merged[0].labels == ("couch", "couch", "bed")


def test_aliases_lead_to_the_entry() -> None:
    labelling = build_labelling(["couch"], [np.ones((2, 2), np.uint16)], {"sofa": "couch"}, min_pixels=1)
    assert labelling.dictionary.id_of("Sofas") == labelling.dictionary.id_of("couch") == 1


@given(maps=_maps, names=st.permutations(["Tasse", "ベッド", "doll"]), exact=st.booleans())
def test_what_is_saved_is_loaded(
    tmp_path_factory: pytest.TempPathFactory, maps: list[np.ndarray], names: list[str], exact: bool
) -> None:
    folder = tmp_path_factory.mktemp("labelling") / "labels"
    entries = tuple(DictionaryEntry(name, (f"{name} 2",), 5 * i, i, 1 / (1 + i)) for i, name in enumerate(names))
    regions = tuple(Regions(m, (((2, 0.25), (1, 0.5)), (), ((3, 1.0),))) for m in maps[: len(maps) * exact])
    labelling = Labelling(Dictionary(entries), tuple(maps), exact, regions)
    save_labelling(Labelling(Dictionary(()), ()), folder)
    save_labelling(labelling, folder)  # replaces the first
    loaded = load_labelling(folder)
    assert loaded.dictionary == labelling.dictionary and loaded.exact is exact
    assert [view.votes for view in loaded.regions] == [view.votes for view in regions]
    for before_ids, after_ids in zip(regions, loaded.regions, strict=True):
        np.testing.assert_array_equal(before_ids.ids, after_ids.ids)
    assert len(loaded.label_maps) == len(maps)
    for before, after in zip(maps, loaded.label_maps, strict=True):
        np.testing.assert_array_equal(before, after)
    assert [path.name for path in folder.parent.iterdir()] == ["labels"]


def test_masks_without_names_come_back_and_damage_is_refused(tmp_path: Path) -> None:
    bits = np.packbits(np.arange(60).reshape(2, 30) % 7 < 3, axis=1)
    view_masks = ViewMasks(bits, np.array([0.5, 0.75], np.float32), 6, 5, 17)
    maps = (np.zeros((5, 6), np.uint16),) * 3
    folder = tmp_path / "labels"
    save_labelling(Labelling(Dictionary(()), maps, masks=(None, view_masks, None)), folder)
    before, loaded, after = load_labelling(folder).masks
    assert before is None and after is None and loaded is not None
    assert (loaded.bits == bits).all() and (loaded.quality == view_masks.quality).all()
    assert (loaded.width, loaded.height, loaded.prompts) == (6, 5, 17)
    path = folder / "masks-000001.npz"
    whole = path.read_bytes()
    for damaged in (whole[:40], b""):
        path.write_bytes(damaged)
        with pytest.raises(InvalidInputError, match="labelling"):
            load_labelling(folder)
    for shape in ([7, 9, 1], [0, 5, 1], [6, 5, -1], [6, 5]):
        np.savez_compressed(path, bits=bits, quality=view_masks.quality, shape=np.array(shape, np.int64))
        with pytest.raises(InvalidInputError, match="labelling"):
            load_labelling(folder)
    path.unlink()
    with pytest.raises(InvalidInputError, match="labelling"):
        load_labelling(folder)


def test_a_damaged_labelling_is_refused(tmp_path: Path) -> None:
    full = np.full((3, 4), 2, np.uint16)
    labelling = Labelling(dictionary_of(["cup", "bed"]), (full,), regions=(Regions(full, (((1, 0.5),), ())),))
    with pytest.raises(InvalidInputError):
        load_labelling(tmp_path / "missing")
    for damage in ("map", "id", "json", "regions", "votes", "confidence"):
        folder = tmp_path / damage
        save_labelling(labelling, folder)
        index = json.loads((folder / "dictionary.json").read_text())
        if damage == "confidence":
            index["entries"][0]["confidence"] = 1.5
        elif damage == "map":
            (folder / "000000.png").write_bytes((folder / "000000.png").read_bytes()[:20])
        elif damage == "regions":
            (folder / "regions-000000.png").unlink()
        elif damage == "votes":
            index["votes"][0][0][0][0] = 3
        elif damage == "id":
            index["entries"].pop()
        text = json.dumps(index)
        (folder / "dictionary.json").write_text(text[: len(text) // 2] if damage == "json" else text)
        with pytest.raises(InvalidInputError, match="labelling"):
            load_labelling(folder)
