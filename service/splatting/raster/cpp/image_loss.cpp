// L1 and SSIM (Wang et al. 2004; 11×11 Gaussian window, σ 1.5, zero padding) with their gradient, in bands of rows. An
// interleaved RGB row is one long row whose neighbors lie 3 floats apart, so all passes run along contiguous memory.
#include "kernels.h"
#include "simd.h"

namespace FS_NS {
using namespace fs;

constexpr int TAPS = SSIM_TAPS, REACH = TAPS / 2;
constexpr float S1 = 0.01f * 0.01f, S2 = 0.03f * 0.03f;
// exp(-(i/1.5)²/2), i = -5..5, over their sum.
static const float window[TAPS] = {0.00102838008447911f, 0.00759875813523919f, 0.0360007721284308f, 0.109360689509700f,
                                   0.213005537711254f,   0.266011724861794f,   0.213005537711254f,  0.109360689509700f,
                                   0.0360007721284308f,  0.00759875813523919f, 0.00102838008447911f};

// Σ_t window[t] · in[j + 3 (t - 5)], `in` aligned and j a multiple of W.
FS_INLINE vf blur_row(const float* in, int64_t j) {
#if defined(FS_AVX512)
  // Shifted in registers: all but one of the eleven loads would cross a cache line.
  const __m512i a = (__m512i)load(in + j - 16), b = (__m512i)load(in + j), c = (__m512i)load(in + j + 16);
  vf acc = set1(window[0]) * (vf)_mm512_alignr_epi32(b, a, 1);
  acc = fma(set1(window[1]), (vf)_mm512_alignr_epi32(b, a, 4), acc);
  acc = fma(set1(window[2]), (vf)_mm512_alignr_epi32(b, a, 7), acc);
  acc = fma(set1(window[3]), (vf)_mm512_alignr_epi32(b, a, 10), acc);
  acc = fma(set1(window[4]), (vf)_mm512_alignr_epi32(b, a, 13), acc);
  acc = fma(set1(window[5]), (vf)b, acc);
  acc = fma(set1(window[6]), (vf)_mm512_alignr_epi32(c, b, 3), acc);
  acc = fma(set1(window[7]), (vf)_mm512_alignr_epi32(c, b, 6), acc);
  acc = fma(set1(window[8]), (vf)_mm512_alignr_epi32(c, b, 9), acc);
  acc = fma(set1(window[9]), (vf)_mm512_alignr_epi32(c, b, 12), acc);
  return fma(set1(window[10]), (vf)_mm512_alignr_epi32(c, b, 15), acc);
#else
  vf acc = set1(window[0]) * loadu(in + j - 3 * REACH);
  for (int t = 1; t < TAPS; t++) acc = fma(set1(window[t]), loadu(in + j + 3 * (t - REACH)), acc);
  return acc;
#endif
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

// The rows of an image that the window around one of its rows covers; zeros where it leaves the image.
struct Rows {
  const float* at[TAPS];
  FS_INLINE Rows around(const float* image, int y, int height, int64_t row, const float* zeros) {
    Rows rows;
    for (int t = 0; t < TAPS; t++) {
      const int other = y + t - REACH;
      rows.at[t] = other < 0 || other >= height ? zeros : image + other * row;
    }
    return rows;
  }
};

// Lines to be blurred along themselves, with zeros on both sides, and a line of zeros.
template <int COUNT>
struct Lines {
  float *line[COUNT], *zeros;
  FS_INLINE Lines of(float* memory, int64_t row) {
    Lines lines;
    const int64_t length = (row + W - 1) / W * W + 2 * SSIM_MARGIN;
    std::memset(memory, 0, (COUNT + 1) * length * sizeof(float));
    for (int i = 0; i < COUNT; i++) lines.line[i] = memory + i * length + SSIM_MARGIN;
    lines.zeros = memory + COUNT * length + SSIM_MARGIN;
    return lines;
  }
};

double image_loss(const ImageLossJob& job, int32_t band, float* memory) {
  const Lines<5> lines = Lines<5>::of(memory, job.row);
  float *const mean = lines.line[0], *const square = lines.line[1], *const product = lines.line[2];
  float *const target_mean = lines.line[3], *const target_square = lines.line[4];
  const int64_t row = job.row;
  const int from = band * SSIM_ROWS, to = from + SSIM_ROWS < job.height ? from + SSIM_ROWS : job.height;
  const vf c1 = set1(S1), c2 = set1(S2), two = set1(2.0f), one = set1(1.0f);
  const vf factor = set1((float)(-job.ssim_weight * job.scale));
  double total = 0;
  for (int y = from; y < to; y++) {
    const Rows xs = Rows::around(job.image, y, job.height, row, lines.zeros);
    const Rows ts = Rows::around(job.target, y, job.height, row, lines.zeros);
    for (int64_t j = 0; j < row; j += W) {
      const int64_t n = row - j;
      vf sums[5] = {zero(), zero(), zero(), zero(), zero()};
#pragma GCC unroll 11
      for (int k = 0; k < TAPS; k++) {
        const vf x = load_some(xs.at[k] + j, n), t = load_some(ts.at[k] + j, n);
        const vf wx = set1(window[k]) * x, wt = set1(window[k]) * t;
        sums[0] = sums[0] + wx;
        sums[1] = fma(wx, x, sums[1]);
        sums[2] = fma(wx, t, sums[2]);
        sums[3] = sums[3] + wt;
        sums[4] = fma(wt, t, sums[4]);
      }
      for (int i = 0; i < 5; i++) store(lines.line[i] + j, sums[i]);
    }
    vf structural = zero(), absolute = zero();
    for (int64_t j = 0; j < row; j += W) {
      const int64_t n = row - j, here = y * row + j;
      const vf weight = counted(job, y, j, n), x = load_some(job.image + here, n), t = load_some(job.target + here, n);
      const vf m = blur_row(mean, j), mt = blur_row(target_mean, j);
      const vf vx = blur_row(square, j) - m * m, vt = blur_row(target_square, j) - mt * mt;
      const vf cov = blur_row(product, j) - m * mt;
      const vf a1 = two * m * mt + c1, a2 = two * cov + c2;
      const vf b1 = m * m + mt * mt + c1, b2 = vx + vt + c2;
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
  const Lines<3> lines = Lines<3>::of(memory, job.row);
  const int64_t row = job.row;
  const int from = band * SSIM_ROWS, to = from + SSIM_ROWS < job.height ? from + SSIM_ROWS : job.height;
  const vf step = set1((float)((1.0 - job.ssim_weight) * job.scale));
  const float* const maps[3] = {job.d_mean, job.d_square, job.d_product};
  for (int y = from; y < to; y++) {
    for (int i = 0; i < 3; i++) {
      const Rows rows = Rows::around(maps[i], y, job.height, row, lines.zeros);
      for (int64_t j = 0; j < row; j += W) {
        vf acc = zero();
#pragma GCC unroll 11
        for (int k = 0; k < TAPS; k++) acc = fma(set1(window[k]), load_some(rows.at[k] + j, row - j), acc);
        store(lines.line[i] + j, acc);
      }
    }
    for (int64_t j = 0; j < row; j += W) {
      const int64_t n = row - j, here = y * row + j;
      const vf x = load_some(job.image + here, n), t = load_some(job.target + here, n);
      const vf sign = keep(gt(x, t), step) - keep(gt(t, x), step);
      const vf smooth =
          blur_row(lines.line[0], j) + (x + x) * blur_row(lines.line[1], j) + t * blur_row(lines.line[2], j);
      store_some(job.grad + here, smooth + sign * counted(job, y, j, n), n);
    }
  }
}

}  // namespace FS_NS
