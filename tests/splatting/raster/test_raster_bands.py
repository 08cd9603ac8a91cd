"""A view in bands of rows: the pixels of the whole image, and never more of them at a time than was asked for."""

from __future__ import annotations

import pytest
import torch
from raster_scenes import View, crowded, relative

from fastsplat.service.splatting.raster import cpu
from fastsplat.service.splatting.raster.image_formation import Backend, RasterSettings
from fastsplat.service.splatting.raster.rendering import label_map, rasterize, rasterize_bands
from fastsplat_contract.errors import InvalidInputError, ResourceError


def wide(channels: int = 5) -> View:
    """Needles and discs far off the axis, where a smaller image's field of view would clamp them differently."""
    return crowded(4, count=300, channels=channels, width=67, height=150)


@pytest.mark.parametrize("max_values", [1, 67 * 5 * 33, 10**9])
def test_bands_are_the_whole_image(isa: str, backend: Backend, max_values: int) -> None:
    view = wide()
    with torch.no_grad():
        whole = rasterize(view.splats, view.viewmat, view.camera, backend=backend)
    rows = 0
    for band, part in rasterize_bands(view.splats, view.viewmat, view.camera, max_values=max_values, backend=backend):
        assert band.start == rows and part.image.shape == (band.stop - band.start, 67, 5)
        rows = band.stop
        assert part.image.numel() <= max(max_values, 16 * 67 * 5)
        for name in ("image", "alpha", "depth", "median_depth"):
            assert torch.equal(getattr(part, name), getattr(whole, name)[band]), name
        assert torch.equal(part.radii, whole.radii)
        assert not part.image.requires_grad
    assert rows == 150


def test_no_gaussians_make_empty_bands(backend: Backend) -> None:
    view = crowded(0, count=0, channels=2, width=20, height=40)
    bands = list(rasterize_bands(view.splats, view.viewmat, view.camera, max_values=1, backend=backend))
    assert sum(part.image.shape[0] for _, part in bands) == 40
    assert all(float(part.image.abs().sum()) == 0.0 for _, part in bands)


@pytest.mark.parametrize("channels", [21, 40])
def test_a_label_map_of_long_codes_is_the_same_in_bands(channels: int, monkeypatch: pytest.MonkeyPatch) -> None:
    view = wide(channels)
    g = torch.Generator().manual_seed(0)
    weight, bias, relevancy = torch.randn(9, 20, generator=g), torch.randn(9, generator=g), torch.rand(9, generator=g)
    maps = []
    for limit in (1, 10**9):
        monkeypatch.setattr(cpu, "_BAND_VALUES", limit)
        maps.append(label_map(view.splats, view.viewmat, view.camera, weight, bias, alpha_min=0.5, relevancy=relevancy))
    for name in ("alpha", "image"):
        assert torch.equal(getattr(maps[0], name), getattr(maps[1], name)), name
    # Torch rounds a product of matrices by their size.
    assert relative(maps[0].relevancy, maps[1].relevancy) < 1e-6
    assert float((maps[0].classes != maps[1].classes).float().mean()) < 0.001


def test_what_does_not_fit_is_refused_as_for_a_whole_image() -> None:
    view = wide()
    with pytest.raises(InvalidInputError):
        next(rasterize_bands(view.splats, view.viewmat * float("nan"), view.camera, max_values=1))
    with pytest.raises(ResourceError):
        next(
            rasterize_bands(view.splats, view.viewmat, view.camera, max_values=1, settings=RasterSettings(max_isects=9))
        )
