"""Project, composite, differentiate, label: one interface, three backends."""

from fastsplat.service.splatting.raster.api import blend_sums, rasterize, rasterize_batch, sh_to_rgb
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.labels import label_map, label_sums
from fastsplat.service.splatting.raster.types import Backend, LabelMap, LabelSums, RasterSettings, Rendering, Splats

__all__ = [
    "Backend",
    "LabelMap",
    "LabelSums",
    "RasterSettings",
    "Rendering",
    "Splats",
    "blend_sums",
    "device_of",
    "label_map",
    "label_sums",
    "rasterize",
    "rasterize_batch",
    "sh_to_rgb",
]
