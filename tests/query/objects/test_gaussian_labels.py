"""One field of labels and one way to draw it, whether a scene keeps its labels in codes or in evidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.query.objects.labeled_objects import label_gaussians
from fastsplat.service.scene.artefact.scene import Evidence, Scene, SemanticHead
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of, no_evidence
from fastsplat_contract.geometry.camera import PosedCamera
from tests.query.conftest import make_scene, plain_index_of
from tests.scenes import labelled_scene


def sure(labels: np.ndarray, count: int) -> Evidence:
    """Every Gaussian seen through a thousand pixels of its label."""
    return evidence_of(np.arange(count), labels, np.full(count, 1000 * UNIT), count)


def as_evidence(scene: Scene) -> Scene:
    """The scene with its codes' labels written down as evidence."""
    classes = label_gaussians(scene).classes
    return replace(scene, evidence=sure(classes, len(classes)))


def test_codes_and_the_same_labels_as_evidence_answer_alike(front: PosedCamera) -> None:
    scene = make_scene(per_label=3)
    codes, evidence = plain_index_of(scene), plain_index_of(as_evidence(scene))
    np.testing.assert_array_equal(codes.gaussian_classes, evidence.gaussian_classes)
    np.testing.assert_array_equal(codes.label_map(front), evidence.label_map(front))
    for label in ("mug", "spoon", "bed"):
        (a,), (b,) = codes.ask([label]), evidence.ask([label])
        np.testing.assert_array_equal(codes.mask3d(a), evidence.mask3d(b))
        seen, evidence_mask = codes.mask2d(a, front), evidence.mask2d(b, front)
        np.testing.assert_array_equal(seen.mask, evidence_mask.mask)
        for match in b.matches:  # the relevancy that is expected where nothing else is seen
            inside = evidence_mask.relevancy[evidence.label_map(front) == match.label_id]
            assert inside.max() == pytest.approx(match.relevancy, rel=0.05)
        np.testing.assert_array_equal(seen.rgb, evidence_mask.rgb)


def test_confidence_is_the_probability_of_the_class() -> None:
    scene = make_scene()
    found = label_gaussians(scene)
    logits = scene.gaussians.codes @ scene.head.weight.T + scene.head.bias
    expected = np.exp(logits.max(1)) / np.exp(logits).sum(1)
    np.testing.assert_allclose(found.confidence, expected, rtol=1e-5)
    assert found.classes.dtype == np.int32 and found.confidence.dtype == np.float32


def test_blended_evidence_never_shows_a_label_that_no_gaussian_on_the_way_has(front: PosedCamera) -> None:
    """Codes on a line have the second label between the first and the third; probabilities have none between."""
    line = np.array([[-1.0, 0], [0, 0], [1, 0]], np.float32)
    head = SemanticHead(np.array([[0, 0], [-8, 0], [0, 0], [8, 0]], np.float32), np.array([-50, 0, 4, 0], np.float32))
    rows = np.repeat([1, 3], 40)
    rng = np.random.default_rng(0)
    means = np.column_stack([rng.uniform(-1, 1, (80, 2)), rng.uniform(-0.5, 0.5, 80)])
    scene = labelled_scene(means, rows, ("mug", "spoon", "bed"), scales=0.25, logit_opacities=0.0)
    codes = replace(scene, gaussians=replace(scene.gaussians, codes=line[rows - 1]), head=head)
    np.testing.assert_array_equal(label_gaussians(codes).classes, rows)
    assert 2 in plain_index_of(codes).label_map(front)
    labels = np.unique(plain_index_of(replace(codes, evidence=sure(rows, 80))).label_map(front))
    assert set(labels.tolist()) <= {0, 1, 3} and {1, 3} <= set(labels.tolist())


def test_what_no_view_has_seen_has_no_label_and_no_say(front: PosedCamera) -> None:
    never = replace(make_scene(), evidence=no_evidence(4))
    found = label_gaussians(never)
    assert not found.classes.any() and not found.confidence.any()
    index = plain_index_of(never)
    assert not index.label_map(front).any()
    seen = index.mask2d(index.ask(["mug"])[0], front)
    assert not seen.mask.any() and not seen.relevancy.any() and seen.rgb.any()


def test_every_pixel_undetected_is_a_scene_of_nothing(front: PosedCamera) -> None:
    scene = make_scene()
    uncoded = replace(scene.gaussians, codes=np.zeros_like(scene.gaussians.codes))
    for blank in (replace(scene, evidence=sure(np.zeros(4, int), 4)), replace(scene, gaussians=uncoded)):
        index = plain_index_of(blank)
        assert not index.gaussian_classes.any() and not index.label_map(front).any()
        (answer,) = index.ask(["mug"])
        assert answer.outcome == "not_here" and answer.matches[0].gaussian_count == 0
        assert answer.sentence == "Not here: nothing in this scene has a name."
        assert not index.mask3d(answer).any() and not index.mask2d(answer, front).mask.any()


def test_a_scene_without_labels(front: PosedCamera) -> None:
    for scene in (make_scene(labels=()), replace(make_scene(labels=()), evidence=no_evidence(1))):
        index = plain_index_of(scene)
        (answer,) = index.ask(["mug"])
        assert answer.matches == () and answer.is_absent
        assert not index.gaussian_classes.any() and not index.label_map(front).any()
        assert not index.mask2d(answer, front).mask.any() and not label_gaussians(scene).confidence.any()


@pytest.mark.parametrize("evidence", [False, True])
def test_ten_thousand_labels(front: PosedCamera, evidence: bool) -> None:
    few = make_scene()
    names = [f"object {number}x" for number in range(10_000)]
    weight = np.zeros((10_001, 4), np.float32)
    weight[[0, 1, 5000, 10_000]] = few.head.weight
    bias = np.full(10_001, -50, np.float32)
    bias[[0, 1, 5000, 10_000]] = 0
    scene = replace(
        few,
        dictionary=dictionary_of(names),
        label_embeddings=np.zeros((10_000, 16), np.float32),
        head=SemanticHead(weight, bias),
    )
    index = plain_index_of(as_evidence(scene) if evidence else scene)
    assert index.gaussian_classes.tolist() == [0, 1, 5000, 10_000]
    assert set(np.unique(index.label_map(front)).tolist()) == {0, 1, 5000, 10_000}
    (answer,) = index.ask(["object 9999x"])
    assert answer.relevant_ids == (10_000,) and index.mask2d(answer, front).mask.any()
