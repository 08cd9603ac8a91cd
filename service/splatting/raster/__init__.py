"""Project, composite, differentiate: one interface, three backends."""

from service.splatting.raster.types import Backend, RasterSettings, Rendering, Splats

__all__ = ["Backend", "RasterSettings", "Rendering", "Splats"]
