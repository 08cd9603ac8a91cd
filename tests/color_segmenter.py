"""A segmenter with MobileSAM's contract: the pixels of the color at the prompt's middle."""

from __future__ import annotations

from pathlib import Path

from tests.networks import write_network

ADAPTER = "sam1:colors"  # as the settings name it

_ENCODER = """
colors (float[1,3,1024,1024] image) => (float[1,256,64,64] image_embeddings)
<int64[8] rest = {0, 0, 0, 0, 0, 253, 0, 0}>
{
  cells = AveragePool<kernel_shape = [16, 16], strides = [16, 16]>(image)
  image_embeddings = Pad(cells, rest)
}
"""

_DECODER = """
colors (float[1,256,64,64] image_embeddings, float[1,N,2] point_coords, float[1,N] point_labels,
        float[1,1,256,256] mask_input, float[1] has_mask_input, float[2] orig_im_size)
  => (float[1,1,256,256] masks, float[1,1] iou_predictions, float[1,1,256,256] low_res_masks)
<float one = {1.0}, int64[1] points = {1}, int64[1] last = {2}, float cell = {16.0}, float least = {0.0},
 float most = {63.0}, int64[1] channel = {1}, int64[1] column = {0}, int64[1] row = {1}, int64[2] flat = {1, 1},
 float tolerance = {120.0}, float steep = {0.5}, int64[4] size = {1, 1, 256, 256},
 float[1,1] iou_constant = {0.9}, int64[1] side = {64}, int64[3] image = {1, 256, 4096}, int64[4] grid = {1, 1, 64, 64}>
{
  inside = GreaterOrEqual(point_labels, one)
  weight = Cast<to = 1>(inside)
  weights = Unsqueeze(weight, last)
  weighted = Mul(point_coords, weights)
  total = ReduceSum<keepdims = 0>(weighted, points)
  count = ReduceSum<keepdims = 1>(weight, points)
  middle = Div(total, count)
  cells = Div(middle, cell)
  floor = Floor(cells)
  kept = Clip(floor, least, most)
  place = Cast<to = 7>(kept)
  x = Gather<axis = 1>(place, column)
  y = Gather<axis = 1>(place, row)
  down = Mul(y, side)
  index = Add(down, x)
  one_index = Reshape(index, row)
  pixels = Reshape(image_embeddings, image)
  color = Gather<axis = 2>(pixels, one_index)
  difference = Sub(pixels, color)
  distances = Abs(difference)
  distance = ReduceSum<keepdims = 1>(distances, channel)
  short = Sub(tolerance, distance)
  scaled = Mul(short, steep)
  small = Reshape(scaled, grid)
  low_res_masks = Resize<mode = "linear">(small, , , size)
  masks = Identity(low_res_masks)
  iou_predictions = Identity(iou_constant)
}
"""


def write_color_segmenter(models: Path) -> None:
    """Put the model into the folder `colors` of a model directory."""
    for name, text in (("encoder", _ENCODER), ("decoder", _DECODER)):
        write_network(models / "colors" / f"{name}.onnx", text)
