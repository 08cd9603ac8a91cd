"""Maps of labels that each Gaussian says a few of: those of an image with a channel a label, on every backend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from raster_scenes import NAMES, View, crowded

from fastsplat.service.splatting.raster import share_maps
from fastsplat.service.splatting.raster.image_formation import Backend, LabelMap
from fastsplat.service.splatting.raster.kernels import running_with
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat.service.splatting.raster.share_maps import ShareMaps
from fastsplat_contract.errors import InvalidInputError


def shares_of(count: int, labels: int, most: int, spread: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """0 to `most` of `labels` labels of each Gaussian, `spread` apart, with their shares."""
    rng = np.random.default_rng(labels)
    sizes = rng.integers(0, min(most, labels) + 1, count)
    names = [np.sort(rng.choice(labels, size, replace=False)) * spread for size in sizes]
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    values = np.concatenate([*names, np.zeros(0)]).astype(np.uint16)
    return starts, values, rng.uniform(0.01, 1, len(values)).astype(np.float32)


def drawn(view: View, shares: tuple[np.ndarray, ...], backend: Backend = "cpu", alpha_min: float = 0.3) -> LabelMap:
    return ShareMaps(*shares).draw(
        view.splats, view.viewmat, view.camera, alpha_min=alpha_min, settings=view.settings, backend=backend
    )


def whole(view: View, shares: tuple[np.ndarray, ...], backend: Backend, alpha_min: float = 0.3) -> torch.Tensor:
    """The labels of an image with a channel for every label that occurs."""
    starts, labels, values = shares
    names, column = np.unique(labels, return_inverse=True)
    table = torch.zeros(len(starts) - 1, len(names))
    table[np.repeat(np.arange(len(starts) - 1), np.diff(starts)), column] = torch.from_numpy(values)
    splats = replace(view.splats, features=table.to(view.splats.means))
    image = rasterize(splats, view.viewmat, view.camera, settings=view.settings, backend=backend)
    best, winner = image.image.max(dim=2)
    first = (image.image == best[..., None]).int().argmax(dim=2)
    assert bool((image.image.gather(2, winner[..., None]) == image.image.gather(2, first[..., None])).all())
    visible = (best > 0) & (image.alpha >= alpha_min)
    return torch.where(visible, torch.from_numpy(names.astype(np.int32))[first], 0).to(torch.int32)


@pytest.mark.parametrize("spread", [1, 601])
@pytest.mark.parametrize(("labels", "most"), [(1, 1), (5, 2), (33, 40), (109, 3), (109, 109)])
def test_labels_are_those_of_an_image_with_a_channel_a_label(
    isa: str, labels: int, most: int, spread: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = crowded(1, count=400, channels=2, width=83, height=61)
    shares = shares_of(400, labels, most, spread)
    assert torch.equal(drawn(view, shares).classes, whole(view, shares, "cpu"))


@pytest.mark.parametrize("bound", [1, 10**9])
def test_pieces_and_bands_make_no_difference(backend: Backend, bound: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(share_maps, "_BAND_VALUES", bound)
    monkeypatch.setattr(share_maps, "_CHANNELS", min(bound, 32) + 3)
    view, shares = crowded(2, channels=1), shares_of(60, 41, 4)
    found = drawn(view, shares, backend)
    assert torch.equal(found.classes, whole(view, shares, backend)) and bool((found.classes > 0).any())
    image = rasterize(view.splats, view.viewmat, view.camera, settings=view.settings, backend=backend)
    assert torch.equal(found.alpha, image.alpha.to(found.alpha)) and found.image.shape[2] == 0


def test_of_equal_labels_the_lower_wins(isa: str, backend: Backend) -> None:
    view = crowded(3, channels=0)
    both = np.tile(np.array([7, 60_000], np.uint16), 60)
    shares = np.arange(61, dtype=np.int64) * 2, both, np.ones(120, np.float32)
    assert set(drawn(view, shares, backend, 0.1).classes.unique().tolist()) == {0, 7}


def test_what_nobody_speaks_of_and_what_is_hardly_covered_is_0(isa: str, backend: Backend) -> None:
    view = crowded(4, channels=0)
    nothing = np.zeros(61, np.int64), np.zeros(0, np.uint16), np.zeros(0, np.float32)
    assert not drawn(view, nothing, backend, 0.0).classes.any()
    shares = shares_of(60, 9, 3)
    covered = drawn(view, shares, backend, 0.6)
    assert not covered.classes[covered.alpha < 0.6].any() and bool(covered.classes.any())
    empty = crowded(4, count=0, channels=0)
    found = drawn(empty, (np.zeros(1, np.int64), *nothing[1:]), backend, 0.0)
    assert not found.classes.any() and not found.alpha.any()


def test_non_finite_gaussians_leave_no_trace(isa: str, backend: Backend) -> None:
    view, (starts, labels, values) = crowded(5, channels=0), shares_of(60, 9, 3)
    means = view.splats.means.clone()
    means[13, 1] = float("nan")
    keep = np.arange(60) != 13
    entries = np.repeat(keep, np.diff(starts))
    rest = np.concatenate([[0], np.cumsum(np.diff(starts)[keep])]), labels[entries], values[entries]
    without = view.with_splats(**{name: getattr(view.splats, name)[keep] for name in NAMES})
    broken = drawn(view.with_splats(means=means), (starts, labels, values), backend)
    assert broken.culled_non_finite == 1
    assert torch.equal(broken.classes, drawn(without, rest, backend).classes)


def test_bits_do_not_depend_on_threads(isa: str) -> None:
    view, shares = crowded(6, count=5000, channels=0, width=150, height=90), shares_of(5000, 70, 5)
    maps = []
    for threads in (1, 3):
        with running_with(threads=threads):
            maps.append(drawn(view, shares))
    assert torch.equal(maps[0].classes, maps[1].classes) and torch.equal(maps[0].alpha, maps[1].alpha)


def test_shares_that_do_not_fit_are_refused() -> None:
    starts, labels, values = shares_of(60, 9, 3)
    beyond, broken = np.append(starts, starts[-1]), values.copy()
    broken[3] = np.nan
    for shares in (
        (starts, labels[1:], values),
        (starts, labels, values[1:]),
        (starts, labels, broken),
        (beyond, labels, values),
    ):
        with pytest.raises(InvalidInputError):
            drawn(crowded(0), shares)
