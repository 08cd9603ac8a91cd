// L1 and SSIM (Wang et al. 2004; 11×11 Gaussian window, σ 1.5, zero padding) with their gradient, in bands of rows. An
// interleaved RGB row is one long row whose neighbors lie 3 floats apart, so all passes run along contiguous memory.
#include "kernels.h"
#include "simd.h"

namespace FS_NS {
using namespace fs;

constexpr int TAPS = 11, REACH = 5, HALO = SSIM_ROWS + 2 * REACH;
constexpr float S1 = 0.01f * 0.01f, S2 = 0.03f * 0.03f;
// exp(-(i/1.5)²/2), i = -5..5, over their sum.
static const float window[TAPS] = {0.00102838008447911f, 0.00759875813523919f, 0.0360007721284308f, 0.109360689509700f,
                                   0.213005537711254f,   0.266011724861794f,   0.213005537711254f,  0.109360689509700f,
                                   0.0360007721284308f,  0.00759875813523919f, 0.00102838008447911f};

FS_INLINE int64_t padded(int64_t row) { return (row + W - 1) / W * W; }

// out[j] = Σ_t window[t] · in[j + 3 (t - 5)]; `in` has REACH·3 zeros before and at least REACH·3 + W after.
FS_INLINE void blur_row(const float* in, int64_t row, float* out) {
  for (int64_t j = 0; j < row; j += W) {
    vf acc = set1(window[0]) * loadu(in + j - 3 * REACH);
    for (int t = 1; t < TAPS; t++) acc = fma(set1(window[t]), loadu(in + j + 3 * (t - REACH)), acc);
    store(out + j, acc);
  }
}

FS_INLINE vf blur_column(const float* top, int64_t stride) {
  vf acc = set1(window[0]) * load(top);
  for (int t = 1; t < TAPS; t++) acc = fma(set1(window[t]), load(top + t * stride), acc);
  return acc;
}

// Whole vectors in the middle of a row, copies at its end; lanes beyond n read 0 and are not written.
FS_INLINE vf load_some(const float* p, int64_t n) {
  if (__builtin_expect(n >= W, 1)) return loadu(p);
  alignas(64) float part[W] = {};
  for (int64_t l = 0; l < n; l++) part[l] = p[l];
  return load(part);
}

FS_INLINE void store_some(float* p, vf a, int64_t n) {
  if (__builtin_expect(n >= W, 1)) return storeu(p, a);
  alignas(64) float part[W];
  store(part, a);
  for (int64_t l = 0; l < n; l++) p[l] = part[l];
}

// 1 where a float of the image counts, else 0.
FS_INLINE vf counted(const ImageLossJob& job, int64_t y, int64_t j, int64_t n) {
  if (!job.valid && n >= W) return set1(1.0f);
  alignas(64) float part[W] = {};
  for (int64_t l = 0; l < n && l < W; l++)
    part[l] = !job.valid || job.valid[y * (job.row / 3) + (j + l) / 3] ? 1.0f : 0.0f;
  return load(part);
}

// Scratch: three planes of HALO blurred rows, then three rows with room on both sides.
struct Scratch {
  float *plane[3], *line[3];
  int64_t stride;
  FS_INLINE Scratch of(float* memory, int64_t row) {
    Scratch s;
    s.stride = padded(row);
    for (int i = 0; i < 3; i++) s.plane[i] = memory + i * HALO * s.stride;
    float* lines = memory + 3 * HALO * s.stride;
    const int64_t length = s.stride + 64 + 64;
    for (int i = 0; i < 3; i++) {
      std::memset(lines + i * length, 0, length * sizeof(float));
      s.line[i] = lines + i * length + 64;
    }
    return s;
  }
};

// Fills the planes for rows [from - REACH, from + SSIM_ROWS + REACH) with blurred fill(row, lines); rows outside are 0.
template <class Fill>
FS_INLINE void blur_rows(const Scratch& s, int count, int from, int height, int64_t row, const Fill& fill) {
  for (int r = 0; r < HALO; r++) {
    const int y = from - REACH + r;
    if (y < 0 || y >= height) {
      for (int i = 0; i < count; i++) std::memset(s.plane[i] + r * s.stride, 0, s.stride * sizeof(float));
      continue;
    }
    fill(y);
    for (int i = 0; i < count; i++) blur_row(s.line[i], row, s.plane[i] + r * s.stride);
  }
}

void target_moments(const ImageLossJob& job, int32_t band, float* memory) {
  const Scratch s = Scratch::of(memory, job.row);
  const int from = band * SSIM_ROWS, to = from + SSIM_ROWS < job.height ? from + SSIM_ROWS : job.height;
  blur_rows(s, 2, from, job.height, job.row, [&](int y) {
    const float* in = job.target + y * job.row;
    for (int64_t j = 0; j < job.row; j++) {
      s.line[0][j] = in[j];
      s.line[1][j] = in[j] * in[j];
    }
  });
  for (int y = from; y < to; y++)
    for (int64_t j = 0; j < job.row; j += W) {
      const int64_t at = (y - from) * s.stride + j;
      const vf mean = blur_column(s.plane[0] + at, s.stride);
      store_some(job.mean + y * job.row + j, mean, job.row - j);
      store_some(job.variance + y * job.row + j, blur_column(s.plane[1] + at, s.stride) - mean * mean, job.row - j);
    }
}

double image_loss(const ImageLossJob& job, int32_t band, float* memory) {
  const Scratch s = Scratch::of(memory, job.row);
  const int64_t row = job.row, stride = s.stride;
  const int from = band * SSIM_ROWS, to = from + SSIM_ROWS < job.height ? from + SSIM_ROWS : job.height;
  blur_rows(s, 3, from, job.height, row, [&](int y) {
    const float *x = job.image + y * row, *t = job.target + y * row;
    for (int64_t j = 0; j < row; j++) {
      s.line[0][j] = x[j];
      s.line[1][j] = x[j] * x[j];
      s.line[2][j] = x[j] * t[j];
    }
  });
  const vf c1 = set1(S1), c2 = set1(S2), two = set1(2.0f), one = set1(1.0f);
  const vf factor = set1((float)(-job.ssim_weight * job.scale));
  double total = 0;
  for (int y = from; y < to; y++) {
    vf structural = zero(), absolute = zero();
    for (int64_t j = 0; j < row; j += W) {
      const int64_t at = (y - from) * stride + j, n = row - j, here = y * row + j;
      const vf weight = counted(job, y, j, n), x = load_some(job.image + here, n), t = load_some(job.target + here, n);
      const vf m = blur_column(s.plane[0] + at, stride), mt = load_some(job.mean + here, n);
      const vf vx = blur_column(s.plane[1] + at, stride) - m * m;
      const vf cov = blur_column(s.plane[2] + at, stride) - m * mt;
      const vf a1 = two * m * mt + c1, a2 = two * cov + c2;
      const vf b1 = m * m + mt * mt + c1, b2 = vx + load_some(job.variance + here, n) + c2;
      const vf inverse = one / (b1 * b2), ssim = a1 * a2 * inverse;
      structural = structural + weight * (one - ssim);
      absolute = absolute + weight * vabs(x - t);
      const vf scale = factor * weight;
      store_some(job.d_mean + here, scale * two * (mt * (a2 - a1) * inverse - m * ssim * (b2 - b1) * inverse), n);
      store_some(job.d_square + here, scale * (zero() - ssim * b1 * inverse), n);
      store_some(job.d_product + here, scale * two * a1 * inverse, n);
    }
    total += job.ssim_weight * (double)sum(structural) + (1.0 - job.ssim_weight) * (double)sum(absolute);
  }
  return total * job.scale;
}

void image_gradient(const ImageLossJob& job, int32_t band, float* memory) {
  const Scratch s = Scratch::of(memory, job.row);
  const int64_t row = job.row, stride = s.stride;
  const int from = band * SSIM_ROWS, to = from + SSIM_ROWS < job.height ? from + SSIM_ROWS : job.height;
  blur_rows(s, 3, from, job.height, row, [&](int y) {
    std::memcpy(s.line[0], job.d_mean + y * row, row * sizeof(float));
    std::memcpy(s.line[1], job.d_square + y * row, row * sizeof(float));
    std::memcpy(s.line[2], job.d_product + y * row, row * sizeof(float));
  });
  const vf step = set1((float)((1.0 - job.ssim_weight) * job.scale));
  for (int y = from; y < to; y++)
    for (int64_t j = 0; j < row; j += W) {
      const int64_t at = (y - from) * stride + j, n = row - j, here = y * row + j;
      const vf x = load_some(job.image + here, n), t = load_some(job.target + here, n);
      const vf sign = keep(gt(x, t), step) - keep(gt(t, x), step);
      const vf smooth = blur_column(s.plane[0] + at, stride) + (x + x) * blur_column(s.plane[1] + at, stride) +
                        t * blur_column(s.plane[2] + at, stride);
      store_some(job.grad + here, smooth + sign * counted(job, y, j, n), n);
    }
}

}  // namespace FS_NS
