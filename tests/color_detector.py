"""A detector of a few arithmetic operations with PicoDet's contract: what is pure magenta is a person, in one box."""

from __future__ import annotations

from pathlib import Path

from tests.networks import EXTENT, write_network

ADAPTER = "picodet:magenta"  # as the settings name it

COLOR = (255, 0, 255)

_NETWORK = """
magenta (float[1,3,416,416] image, float[1,2] scale_factor) => (float[1,6] rows)
<float high = {1.6}, float low = {-1.2}, float sure = {0.9}, float one = {1.0}, int64[1] channels = {1},
 int64[3] sizes = {1, 1, 1},
 int64[2] pair = {1, 1}, float[1,1] person = {0.0}>
{
  red, green, blue = Split<axis = 1>(image, sizes)
  bright = Greater(red, high)
  vivid = Greater(blue, high)
  dark = Less(green, low)
  both = And(bright, vivid)
  mask = And(both, dark)
EXTENT
  score = Mul(most, sure)
  x2_end = Add(x2, one)
  y2_end = Add(y2, one)
  y_scale, x_scale = Split<axis = 1>(scale_factor, pair)
  x1_px = Div(x1, x_scale)
  x2_px = Div(x2_end, x_scale)
  y1_px = Div(y1, y_scale)
  y2_px = Div(y2_end, y_scale)
  rows = Concat<axis = 1>(person, score, x1_px, y1_px, x2_px, y2_px)
}
"""


def write_color_detector(models: Path) -> None:
    """Put the model into the folder `magenta` of a model directory."""
    write_network(models / "magenta" / "network.onnx", _NETWORK.replace("EXTENT", EXTENT))
