"""Label maps and label sums: each backend against what they abbreviate, and the laws that follow from it."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from raster_scenes import NAMES, View, crowded, relative, render

from fastsplat.service.splatting.raster.image_formation import Backend, LabelMap, LabelSums, RasterSettings, Splats
from fastsplat.service.splatting.raster.kernels import running_with
from fastsplat.service.splatting.raster.rendering import accumulate_weights, label_map, label_sums, rasterize
from fastsplat_contract.errors import InvalidInputError, ResourceError


def head(classes: int, size: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    return 3.0 * torch.randn(classes, size, generator=g), torch.randn(classes, generator=g)


def mapped(
    view: View, weight: torch.Tensor, bias: torch.Tensor, backend: Backend = "cpu", **options: object
) -> LabelMap:
    given = {"alpha_min": 0.5, "backend": backend, **options}
    return label_map(view.splats, view.viewmat, view.camera, weight, bias, **given)


def summed(view: View, labels: torch.Tensor, classes: int, backend: Backend = "cpu") -> LabelSums:
    return label_sums(view.splats, view.viewmat, view.camera, labels, classes, settings=view.settings, backend=backend)


def patches(view: View, classes: int, seed: int = 0, side: int = 5) -> torch.Tensor:
    """Label maps are made of patches, not of noise."""
    height, width = view.camera.height, view.camera.width
    shape = (height // side + 1, width // side + 1)
    small = torch.randint(0, classes, shape, generator=torch.Generator().manual_seed(seed))
    return small.repeat_interleave(side, 0).repeat_interleave(side, 1)[:height, :width].contiguous()


@pytest.mark.parametrize("size", [0, 1, 3, 8, 13, 16, 21, 40])
@pytest.mark.parametrize("classes", [1, 2, 18])
def test_a_label_map_is_the_argmax_of_the_composited_codes(isa: str, size: int, classes: int) -> None:
    view = crowded(1, channels=size)
    weight, bias = head(classes, size)
    relevancy = torch.rand(classes, generator=torch.Generator().manual_seed(1))
    truth = mapped(view, weight, bias, "reference", relevancy=relevancy)
    ours = mapped(view, weight, bias, relevancy=relevancy)
    assert ours.classes.dtype == torch.int32 and ours.image.shape == (29, 37, 0)
    assert relative(ours.alpha, truth.alpha) < 1e-5
    # Where two classes are as good as equal, rounding decides.
    splats = replace(view.splats, means=view.splats.means.double(), features=view.splats.features.double())
    codes = rasterize(splats, view.viewmat, view.camera, backend="reference").image
    logits = codes @ weight.double().T + bias.double()
    margin = logits.amax(dim=2) - logits.gather(2, ours.classes.long()[..., None])[..., 0]
    assert bool(((margin < 1e-3) | (ours.classes == 0)).all())
    assert float((ours.classes != truth.classes).float().mean()) < 0.005
    assert relative(ours.relevancy, truth.relevancy) < 1e-4
    assert float(ours.relevancy.min()) >= 0.0 and float(ours.relevancy.max()) <= 1.0 + 1e-5


def test_pixels_below_the_alpha_bound_are_undetected_and_all_others_are_not(isa: str, backend: Backend) -> None:
    view = crowded(2, channels=3)
    bias = torch.tensor([-1e6, 0.0])
    found = mapped(view, torch.zeros(2, 3), bias, backend, alpha_min=0.7)
    assert torch.equal(found.classes, (found.alpha >= 0.7).to(torch.int32))
    assert 0 < int(found.classes.sum()) < found.classes.numel()


def test_ties_go_to_the_lower_id(isa: str, backend: Backend) -> None:
    view = crowded(3, channels=2)
    weight = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0], [1.0, 0.0]])
    found = mapped(view, weight, torch.tensor([-1e4, 0.0, 0.0, 0.0]), backend, alpha_min=0.0)
    assert set(found.classes.unique().tolist()) == {1, 3}
    assert set(mapped(view, 0 * weight, torch.zeros(4), backend).classes.unique().tolist()) == {0}


@pytest.mark.parametrize("extra", [1, 3, 9])
def test_channels_before_the_codes_come_back_as_an_image(isa: str, extra: int) -> None:
    view = crowded(4, channels=extra + 8)
    weight, bias = head(18, 8)
    whole = mapped(view, weight, bias)
    picture = rasterize(view.splats, view.viewmat, view.camera).image
    assert torch.equal(whole.image, picture[..., :extra])
    codes = view.with_splats(features=view.splats.features[:, extra:].contiguous())
    assert float((mapped(codes, weight, bias).classes != whole.classes).float().mean()) < 0.005


def test_ten_thousand_classes(isa: str) -> None:
    view = crowded(5, count=30, channels=8, width=33, height=17)
    weight, bias = head(10_000, 8)
    relevancy = torch.zeros(10_000)
    relevancy[5_000:] = 1.0
    truth = mapped(view, weight, bias, "reference", relevancy=relevancy)
    ours = mapped(view, weight, bias, relevancy=relevancy)
    assert float((ours.classes != truth.classes).float().mean()) < 0.02
    assert int(ours.classes.max()) > 5_000
    assert float((ours.relevancy - truth.relevancy).abs().max()) < 1e-3


def test_logits_near_the_largest_float_stay_finite(isa: str, backend: Backend) -> None:
    view = crowded(6, channels=2)
    weight = torch.tensor([[1e38, -1e38], [-1e38, 1e38], [0.0, 0.0]])
    found = mapped(view, weight, torch.zeros(3), backend, alpha_min=0.0, relevancy=torch.tensor([0.0, 1.0, 0.5]))
    assert found.relevancy is not None and bool(torch.isfinite(found.relevancy).all())
    assert set(found.classes.unique().tolist()) <= {0, 1, 2}


def test_non_finite_gaussians_leave_no_trace_in_labels(isa: str, backend: Backend) -> None:
    view = crowded(7, channels=4)
    weight, bias = head(6, 4)
    keep = torch.arange(60) != 13
    without = view.with_splats(**{name: getattr(view.splats, name)[keep] for name in NAMES})
    features = view.splats.features.clone()
    features[13, 2] = float("nan")
    broken = view.with_splats(features=features)
    found, wanted = mapped(broken, weight, bias, backend), mapped(without, weight, bias, backend)
    assert found.culled_non_finite == 1 and wanted.culled_non_finite == 0
    assert torch.equal(found.classes, wanted.classes)
    labels = patches(view, 6)
    sums = summed(broken, labels, 6, backend).dense(6)
    assert float(sums[13].sum()) == 0.0
    assert torch.equal(sums[keep], summed(without, labels, 6, backend).dense(6))


def test_no_gaussians_make_an_empty_map(isa: str, backend: Backend) -> None:
    view = crowded(8, count=0, channels=3)
    weight, bias = head(4, 3)
    found = mapped(view, weight, bias, backend, relevancy=torch.ones(4))
    assert int(found.classes.abs().sum()) == 0 and float(found.alpha.abs().sum()) == 0.0
    sums = summed(view, patches(view, 4), 4, backend)
    assert sums.starts.tolist() == [0] and len(sums.labels) == 0


def test_heads_that_do_not_fit_are_refused() -> None:
    view, (weight, bias), relevancy = crowded(0, channels=3), head(4, 3), torch.ones(4)
    for bad in (
        (weight * torch.inf, bias, relevancy),
        (weight, bias[:3], relevancy),
        (weight, bias, torch.ones(5)),
        (torch.ones(4, 4), bias, relevancy),
    ):
        with pytest.raises(InvalidInputError):
            mapped(view, *bad[:2], relevancy=bad[2])


@pytest.mark.parametrize("threads", [2, 3, 5])
def test_bits_do_not_depend_on_threads(isa: str, threads: int) -> None:
    view = crowded(9, count=9000, channels=8, width=150, height=90)
    weight, bias = head(18, 8)
    labels = patches(view, 18)
    results = []
    for number in (1, threads):
        with running_with(threads=number):
            seen, sums = mapped(view, weight, bias, relevancy=bias.sigmoid()), summed(view, labels, 18)
        results.append((seen.classes, seen.alpha, seen.relevancy, sums.starts, sums.labels, sums.sums))
    for first, second in zip(*results, strict=True):
        assert first is not None and second is not None and torch.equal(first, second)


@pytest.mark.parametrize("side", [1, 5])
@pytest.mark.parametrize("classes", [1, 3, 18, 500])
def test_label_sums_are_accumulated_weights_of_one_hot_labels(isa: str, classes: int, side: int) -> None:
    view = crowded(10)
    labels = patches(view, classes, side=side)
    one_hot = torch.nn.functional.one_hot(labels, classes).float()
    truth = accumulate_weights(view.splats, view.viewmat, view.camera, one_hot.double(), backend="reference")
    ours = summed(view, labels, classes)
    assert relative(ours.dense(classes), truth) < 1e-5
    assert torch.equal(ours.starts, ours.starts.sort().values) and int(ours.starts[-1]) == len(ours.labels)
    rows = torch.repeat_interleave(torch.arange(60), ours.starts.diff())
    keys = rows * classes + ours.labels
    assert bool((keys.diff() > 0).all())
    assert float(ours.sums.min()) > 0.0
    same = summed(view, labels, classes, "reference")
    assert relative(same.dense(classes), truth) < 1e-6


def test_all_labels_together_are_the_alpha_and_ignored_pixels_are_missing(isa: str, backend: Backend) -> None:
    view = crowded(11)
    labels = patches(view, 7)
    alpha = render(view, backend).alpha
    assert float(summed(view, labels, 7, backend).sums.sum()) == pytest.approx(float(alpha.sum()), rel=1e-5)
    labels[:, :18] = -1  # within a block of pixels
    assert float(summed(view, labels, 7, backend).sums.sum()) == pytest.approx(float(alpha[:, 18:].sum()), rel=1e-5)
    labels[:] = -5
    assert len(summed(view, labels, 7, backend).labels) == 0


def test_labels_that_do_not_fit_are_refused(backend: Backend) -> None:
    view = crowded(0)
    for labels in (torch.full((29, 37), 4), torch.zeros(29, 37), torch.zeros(37, 29, dtype=torch.int64)):
        with pytest.raises(InvalidInputError):
            summed(view, labels, 4, backend)


def test_entries_are_bounded_like_intersections(isa: str) -> None:
    view = replace(crowded(13, count=400), settings=RasterSettings(max_isects=3000))
    assert isinstance(rasterize(view.splats, view.viewmat, view.camera, settings=view.settings).alpha, torch.Tensor)
    with pytest.raises(ResourceError, match="max_isects"):
        summed(view, torch.arange(29 * 37).reshape(29, 37), 29 * 37)


def test_gradients_are_not_recorded() -> None:
    view = crowded(0, channels=3)
    parts = Splats(*(getattr(view.splats, name).requires_grad_() for name in NAMES))
    weight, bias = head(4, 3)
    found = label_map(parts, view.viewmat, view.camera, weight.requires_grad_(), bias, alpha_min=0.1)
    assert not found.alpha.requires_grad
    assert not label_sums(parts, view.viewmat, view.camera, patches(view, 4), 4).sums.requires_grad
