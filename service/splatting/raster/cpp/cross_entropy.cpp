// Affine map, softmax and weighted cross-entropy of W pixels at a time; of the H×W×N logits only one vector per class
// ever exists. Derivative of the cross-entropy: softmax − one-hot.
#include "kernels.h"
#include "simd.h"

namespace FS_NS {
using namespace fs;

constexpr float LIMIT = 1e30f, LOG2_E = 1.4426950408889634f;

// SIZE = 0: the code's size is read at run time. Scratch: classes vectors of logits, then classes·(size + 1) vectors of
// gradients of weight and bias.
template <int SIZE>
static void cross_entropy_of_size(const CrossEntropyJob& job, int64_t task, float* scratch) {
  const int size = SIZE ? SIZE : job.size, classes = job.classes;
  float* logits = scratch;
  float* sums = scratch + (int64_t)classes * W;
  std::memset(sums, 0, (int64_t)classes * (size + 1) * W * sizeof(float));
  const int64_t begin = task * CROSS_ENTROPY_PIXELS,
                end = begin + CROSS_ENTROPY_PIXELS < job.pixels ? begin + CROSS_ENTROPY_PIXELS : job.pixels;
  double loss = 0;
  for (int64_t p = begin; p < end; p += W) {
    const int n = (int)(end - p < W ? end - p : W);
    alignas(64) float weights[W] = {}, code[MAX_CODE_SIZE][W], d_code[MAX_CODE_SIZE][W];
    bool counted = false;
    for (int l = 0; l < n; l++) {
      weights[l] = job.class_weights[job.labels[p + l]];
      counted |= weights[l] > 0;
    }
    float* out = job.d_codes + p * size;
    if (!counted) {
      std::memset(out, 0, (int64_t)n * size * sizeof(float));
      continue;
    }
    for (int d = 0; d < size; d++)
      for (int l = 0; l < W; l++) code[d][l] = l < n ? job.codes[(p + l) * job.code_stride + d] : 0.0f;
    vf top = set1(-LIMIT);
    for (int k = 0; k < classes; k++) {
      vf logit = set1(job.bias[k]);
      for (int d = 0; d < size; d++) logit = fma(set1(job.weight[(int64_t)k * size + d]), load(code[d]), logit);
      logit = vmin(vmax(logit, set1(-LIMIT)), set1(LIMIT));
      store(logits + (int64_t)k * W, logit);
      top = vmax(top, logit);
    }
    alignas(64) float tops[W], totals[W], picked[W] = {};
    store(tops, top);
    for (int l = 0; l < n; l++) picked[l] = logits[(int64_t)job.labels[p + l] * W + l];
    vf total = zero();
    for (int k = 0; k < classes; k++) {
      const vf e = exp2((load(logits + (int64_t)k * W) - top) * set1(LOG2_E));
      store(logits + (int64_t)k * W, e);
      total = total + e;
    }
    store(totals, total);
    for (int l = 0; l < n; l++)
      if (weights[l] > 0)
        loss += (double)weights[l] * (((double)tops[l] - (double)picked[l]) + (double)std::log(totals[l]));
    const vf factor = load(weights) * set1((float)job.scale), share = factor / total;
    for (int k = 0; k < classes; k++) store(logits + (int64_t)k * W, load(logits + (int64_t)k * W) * share);
    alignas(64) float factors[W];
    store(factors, factor);
    for (int l = 0; l < n; l++) logits[(int64_t)job.labels[p + l] * W + l] -= factors[l];
    for (int d = 0; d < size; d++) store(d_code[d], zero());
    for (int k = 0; k < classes; k++) {
      const vf g = load(logits + (int64_t)k * W);
      float* into = sums + (int64_t)k * (size + 1) * W;
      for (int d = 0; d < size; d++) {
        store(d_code[d], fma(set1(job.weight[(int64_t)k * size + d]), g, load(d_code[d])));
        store(into + d * W, fma(g, load(code[d]), load(into + d * W)));
      }
      store(into + size * W, load(into + size * W) + g);
    }
    for (int l = 0; l < n; l++)
      for (int d = 0; d < size; d++) out[l * size + d] = d_code[d][l];
  }
  job.loss[task] = loss;
  float* partial = job.partial + task * (int64_t)classes * (size + 1);
  for (int64_t i = 0; i < (int64_t)classes * (size + 1); i++) partial[i] = sum(load(sums + i * W));
}

void cross_entropy(const CrossEntropyJob& job, int64_t task, float* scratch) {
  if (job.size == 3) return cross_entropy_of_size<3>(job, task, scratch);
  if (job.size == 4) return cross_entropy_of_size<4>(job, task, scratch);
  if (job.size == 6) return cross_entropy_of_size<6>(job, task, scratch);
  if (job.size == 8) return cross_entropy_of_size<8>(job, task, scratch);
  cross_entropy_of_size<0>(job, task, scratch);
}

}  // namespace FS_NS
