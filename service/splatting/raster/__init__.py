"""Project, composite, differentiate, label: one interface, three backends."""

from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.rendering import (
    accumulate_weights,
    label_map,
    label_sums,
    rasterize,
    rasterize_bands,
    sh_to_rgb,
)
from fastsplat.service.splatting.raster.share_maps import ShareMaps
from fastsplat.service.splatting.raster.types import Backend, LabelMap, LabelSums, RasterSettings, Rendering, Splats

__all__ = [
    "Backend",
    "LabelMap",
    "LabelSums",
    "RasterSettings",
    "Rendering",
    "ShareMaps",
    "Splats",
    "accumulate_weights",
    "device_of",
    "label_map",
    "label_sums",
    "rasterize",
    "rasterize_bands",
    "sh_to_rgb",
]
