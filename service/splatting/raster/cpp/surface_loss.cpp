// How far blended depths lie apart and how far surfaces are from planes, with the gradients: what
// depth_regularization.py computes, row by row. Loops over a row are plain, so that the compiler
// makes vectors of them; only the exponential is written with vectors.
#include "kernels.h"
#include "simd.h"

namespace FS_NS {
using namespace fs;

constexpr float EDGE_EXPONENT = -20.0f * 1.4426950408889634f;

// Inverse depth where a pixel is covered and counts, else 0.
void surface_inverse(const SurfaceJob& job, int32_t y) {
  const int64_t row = (int64_t)y * job.width;
  const float *alpha = job.alpha + row, *depth = job.depth + row;
  float* out = job.inverse + row;
  for (int64_t x = 0; x < job.width; x++)
    out[x] = alpha[x] > job.alpha_min && depth[x] > 0 ? alpha[x] / depth[x] : 0.0f;
  if (!job.valid) return;
  for (int64_t x = 0; x < job.width; x++) out[x] = job.valid[row + x] ? out[x] : 0.0f;
}

// The largest difference of a channel, of `pixels` pairs of colors.
static void color_steps(const float* one, const float* other, int64_t pixels, float* out) {
  for (int64_t x = 0; x < pixels; x++) {
    const float r = std::fabs(one[3 * x] - other[3 * x]), g = std::fabs(one[3 * x + 1] - other[3 * x + 1]),
                b = std::fabs(one[3 * x + 2] - other[3 * x + 2]);
    const float rg = r > g ? r : g;
    out[x] = rg > b ? rg : b;
  }
}

// Loss of `count` pixels, and the gradient by their bends. Scratch `edge` has whole vectors; it is overwritten.
static double bends(const float* before, const float* here, const float* after, float* edge, int64_t count, float scale,
                    float* gradient) {
  for (int64_t x = 0; x < count; x += W) store(edge + x, exp2(load(edge + x) * set1(EDGE_EXPONENT)));
  for (int64_t x = 0; x < count; x++) {
    const bool known = before[x] > 0 && here[x] > 0 && after[x] > 0;
    const float curve = before[x] - 2 * here[x] + after[x], size = std::fabs(curve);
    const float share = known ? size / here[x] : 0.0f, weight = known ? edge[x] * scale : 0.0f;
    const float slope = share <= 1 && curve != 0 ? weight / (known ? here[x] : 1.0f) : 0.0f;
    gradient[x] = curve < 0 ? -slope : slope;
    edge[x] = weight * (share < 1 ? share : 1.0f);
  }
  double loss = 0;
  for (int64_t x = 0; x < count; x++) loss += (double)edge[x];
  return loss;
}

double surface_bends(const SurfaceJob& job, int32_t y, float* scratch) {
  const int64_t width = job.width, step = job.step, row = (int64_t)y * width, padded = surface_padded(job.width);
  float *edge = scratch, *steps = scratch + padded;
  const float *inverse = job.inverse + row, *target = job.target + 3 * row;
  float *bend_x = job.bend_x + row, *bend_y = job.bend_y + row;
  std::memset(scratch, 0, 2 * padded * sizeof(float));
  std::memset(bend_x, 0, width * sizeof(float));
  std::memset(bend_y, 0, width * sizeof(float));
  double loss = 0;
  if (width > 2 * step) {
    const int64_t count = width - 2 * step;
    color_steps(target + 3 * step, target, width - step, steps);
    for (int64_t x = 0; x < count; x++) edge[x] = steps[x] > steps[x + step] ? steps[x] : steps[x + step];
    loss += bends(inverse, inverse + step, inverse + 2 * step, edge, count, job.scale_x, bend_x + step);
  }
  if (y >= step && y + step < job.height) {
    const int64_t apart = step * width;
    std::memset(edge, 0, padded * sizeof(float));
    color_steps(target - 3 * apart, target, width, steps);
    color_steps(target + 3 * apart, target, width, edge);
    for (int64_t x = 0; x < width; x++) edge[x] = steps[x] > edge[x] ? steps[x] : edge[x];
    loss += bends(inverse - apart, inverse, inverse + apart, edge, width, job.scale_y, bend_y);
  }
  return loss;
}

// All gradients of a row from the bends of the rows around it; and its loss of spread.
double surface_gradient(const SurfaceJob& job, int32_t y, float* scratch) {
  const int64_t width = job.width, step = job.step, row = (int64_t)y * width, apart = step * width;
  const float *alpha = job.alpha + row, *depth = job.depth + row, *inverse = job.inverse + row;
  const float *squared = job.squared + row * job.squared_stride, *bend_x = job.bend_x + row, *bend_y = job.bend_y + row;
  float *d_alpha = job.d_alpha + row, *d_depth = job.d_depth + row, *d_squared = job.d_squared + row;
  float* slope = scratch;
  for (int64_t x = 0; x < width; x++) slope[x] = -2 * (bend_x[x] + bend_y[x]);
  for (int64_t x = step; x < width; x++) slope[x] += bend_x[x - step];
  for (int64_t x = 0; x < width - step; x++) slope[x] += bend_x[x + step];
  if (y >= step)
    for (int64_t x = 0; x < width; x++) slope[x] += bend_y[x - apart];
  if (y + step < job.height)
    for (int64_t x = 0; x < width; x++) slope[x] += bend_y[x + apart];
  for (int64_t x = 0; x < width; x++) {
    const bool covered = alpha[x] > job.alpha_min && depth[x] != 0;
    const float a = covered ? alpha[x] : 0.0f, z = covered ? depth[x] : 1.0f, share = a / z;
    const float mean = covered ? squared[x * job.squared_stride] : 0.0f, spread = a * mean - z * z;
    const float scale = covered && spread >= 0 ? job.spread_scale * share * share : 0.0f;
    const float bent = inverse[x] > 0 ? slope[x] / z : 0.0f;
    d_alpha[x] = scale * mean + bent;
    d_depth[x] = -2 * scale * z - bent * share;
    d_squared[x] = scale * a;
    slope[x] = scale * spread;
  }
  double loss = 0;
  for (int64_t x = 0; x < width; x++) loss += (double)slope[x];
  return loss;
}

}  // namespace FS_NS
