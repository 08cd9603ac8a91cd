"""Project, composite, differentiate: one interface, three backends."""

from service.splatting.raster.api import blend_sums, rasterize, sh_to_rgb
from service.splatting.raster.types import Backend, RasterSettings, Rendering, Splats

__all__ = ["Backend", "RasterSettings", "Rendering", "Splats", "blend_sums", "rasterize", "sh_to_rgb"]
