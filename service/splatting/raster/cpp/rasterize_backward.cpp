// The backward pass over a tile: Gaussian by Gaussian, from back to front.
#include "pixels.h"

namespace FS_NS {

// Sums over one Gaussian's pixels of a tile. Where registers hold either the moments or the features, the weights of
// all blocks are kept and the features follow in a loop of their own.
template <int K>
struct Sums {
  static constexpr int SLOTS = (MOMENTS + K + W - 1) / W * W;
  static constexpr bool TOGETHER = W == 16 && K <= 12;
  vf slot[SLOTS];
};

// With R the color behind a pixel's Gaussian, seen through it and weighted by the gradient, d loss / d alpha = T (dot −
// R) and, one step to the front, R + alpha (dot − R): nothing is divided by the remaining transmittance, which may be
// tiny. What does not depend on another block is computed for all blocks first, so that the processor can overlap their
// long dependency chains.
template <int K>
FS_INLINE void gradients(const Ellipse& e, const float* features, uint64_t bits, int64_t i, vf log_min, vf alpha_max,
                         Block<K>* blocks, Sums<K>& sums) {
  vf zeroth = zero(), first[2] = {zero(), zero()}, second[3] = {zero(), zero(), zero()}, feature[K];
  alignas(64) float weights[BLOCKS][W], raws[BLOCKS][W], us[BLOCKS][W], dot[BLOCKS][W], vs[BLOCKS][W];
  Block<K>* visited[BLOCKS];
  int count = 0;
  const vi now = set1i((int32_t)i);
#pragma GCC unroll 20
  for (int k = 0; k < K; k++) feature[k] = zero();
  for (; bits; bits &= bits - 1) {
    const int index = __builtin_ctzll(bits);
    Block<K>& block = blocks[index];
    vf u, v;
    const vf exponent = Ellipse::exponent(e, block, u, v);
    const vm on = both(ge(exponent, log_min), gti(loadi(block.stop), now));
    store(raws[count], keep(on, exp2_normal(exponent)));
    store(us[count], u);
    store(vs[count], v);
    vf dots[2] = {load(block.extra), zero()};
#pragma GCC unroll 20
    for (int k = 0; k < K; k++) dots[k % 2] = fma(set1(features[k]), load(block.values[k]), dots[k % 2]);
    store(dot[count], dots[0] + dots[1]);
    visited[count++] = &block;
  }
  for (int n = 0; n < count; n++) {
    Block<K>& block = *visited[n];
    const vf raw = load(raws[n]), u = load(us[n]), v = load(vs[n]), alpha = vmin(raw, alpha_max);
    const vf before = load(block.remaining) * (set1(1.0f) / (set1(1.0f) - alpha));
    const vf weight = alpha * before;
    store(block.remaining, before);
#pragma GCC unroll 20
    for (int k = 0; k < K; k++) {
      const vf grad = load(block.values[k]);
      if (Sums<K>::TOGETHER) feature[k] = fma(weight, grad, feature[k]);
    }
    if (!Sums<K>::TOGETHER) store(weights[n], weight);
    const vf behind = load(block.other), difference = load(dot[n]) - behind;
    store(block.other, fma(alpha, difference, behind));
    const vf g = keep(le(raw, alpha_max), weight * difference);
    const vf gu = g * u, gv = g * v;
    zeroth = zeroth + g;
    first[0] = first[0] + gu;
    first[1] = first[1] + gv;
    second[0] = fma(gu, u, second[0]);
    second[1] = fma(gu, v, second[1]);
    second[2] = fma(gv, v, second[2]);
  }
  if (!Sums<K>::TOGETHER)
    for (int n = 0; n < count; n++) {
      const Block<K>& block = *visited[n];
      const vf weight = load(weights[n]);
#pragma GCC unroll 20
      for (int k = 0; k < K; k++) feature[k] = fma(weight, load(block.values[k]), feature[k]);
    }
  sums.slot[0] = zeroth;
  for (int m = 0; m < 2; m++) sums.slot[1 + m] = first[m];
  for (int m = 0; m < 3; m++) sums.slot[3 + m] = second[m];
#pragma GCC unroll 20
  for (int k = 0; k < K; k++) sums.slot[MOMENTS + k] = feature[k];
  for (int k = MOMENTS + K; k < Sums<K>::SLOTS; k++) sums.slot[k] = zero();
}

template <int K>
static void backward_group(const TileJob& job, int32_t tile) {
  const Tile t = tile_of(job, tile);
  prefetch_pixels(t, job, job.grad_image);
  Block<K> blocks[BLOCKS];  // other: R above; extra: gradient of alpha
  start_blocks(blocks);
  const int skip = job.first ? 1 : 0;
  for (int b = 0; b < BLOCKS; b++) {
    store(blocks[b].remaining, load(job.final_t + (int64_t)tile * PIXELS + b * W));
    storei(blocks[b].stop, loadi(job.stop + (int64_t)tile * PIXELS + b * W));
  }
  read_pixels<K>(job, t, blocks);
  const vf log_min = set1(job.log_alpha_min), alpha_max = set1((float)job.view.alpha_max);
  const int offset = job.first ? GEOMETRY : GEOMETRY + 1 + job.channel_begin;
  const int place = job.first ? MOMENTS : MOMENTS + 1 + job.channel_begin, used_slots = job.group + skip;
  const bool whole = job.first && job.sum_stride >= Sums<K>::SLOTS;
  const int64_t used = job.tile_used[tile];
  for (int64_t i = t.count - 1; i >= 0; i--) {
    if (i >= AHEAD) {
      prefetch(job.records + (int64_t)job.isects[t.begin + i - AHEAD].rank * job.stride, job.stride);
      __builtin_prefetch(job.sums + (int64_t)job.isects[t.begin + i - AHEAD].slot * job.sum_stride, 1);
    }
    float* out = job.sums + (int64_t)job.isects[t.begin + i].slot * job.sum_stride;
    const uint64_t bits = i < used ? job.isects[t.begin + i].blocks : 0;
    if (!bits) {
      if (job.first)
        for (int k = 0; k < MOMENTS; k++) out[k] = 0;
      for (int k = 0; k < used_slots; k++) out[place + k] = 0;
      continue;
    }
    const float* record = job.records + (int64_t)job.isects[t.begin + i].rank * job.stride;
    Sums<K> sums;
    gradients(Ellipse::from(record, t.left, t.top), record + offset, bits, i, log_min, alpha_max, blocks, sums);
    if (whole) {
      store_sums(sums.slot, Sums<K>::SLOTS, out);
      continue;
    }
    alignas(64) float totals[Sums<K>::SLOTS];
    store_sums(sums.slot, Sums<K>::SLOTS, totals);
    for (int k = 0; k < MOMENTS; k++) out[k] = job.first ? totals[k] : out[k] + totals[k];
    for (int k = 0; k < used_slots; k++) out[place + k] = totals[MOMENTS + k];
  }
}

void rasterize_backward(const TileJob& job, int32_t tile) {
  with_slot_width(job.group + job.first, [&](auto width) { backward_group<decltype(width)::value>(job, tile); });
}

}  // namespace FS_NS
