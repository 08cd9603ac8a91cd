// Front to back over one tile, for images and label maps alike. Block by block, so that a block's pixels stay in
// registers while its Gaussians come in order of depth; what a tile needs of them is first copied together, and their
// block masks are turned into one list per block.
#pragma once
#include "pixels.h"

namespace FS_NS {

constexpr int PART = 256;  // Gaussians a time: their copies stay in the first-level cache

template <int K>
struct alignas(64) Part {
  static constexpr int U = 0, V = 1, SHAPE = 2,
                       FEATURES = 6;  // offsets at the tile's first pixel; a, b, c, log_opacity
  static constexpr int ROW = (FEATURES + K + 3) / 4 * 4;
  float rows[PART][ROW];
  uint8_t masks[BLOCKS / 8][PART];  // bit = block, eight blocks a plane
  int64_t count;
};

template <int K>
FS_INLINE void gather(const TileJob& job, const Tile& t, int64_t start, Part<K>& part) {
  const int offset = job.first ? GEOMETRY : GEOMETRY + 1 + job.channel_begin;
  part.count = t.count - start < PART ? t.count - start : PART;
  const int64_t begin = t.begin + start, ahead = t.count - start - AHEAD;
  for (int64_t j = 0; j < part.count; j++) {
    if (j < ahead) prefetch(job.records + (int64_t)job.isects[begin + j + AHEAD].rank * job.stride, job.stride);
    const float* record = job.records + (int64_t)job.isects[begin + j].rank * job.stride;
    float* out = part.rows[j];
    offsets(record, t.left, t.top, out[Part<K>::U], out[Part<K>::V]);
    std::memcpy(out + Part<K>::SHAPE, record + 4, 4 * sizeof(float));
    std::memcpy(out + Part<K>::FEATURES, record + offset, K * sizeof(float));
    const uint64_t mask = job.isects[begin + j].blocks;
    for (int p = 0; p < BLOCKS / 8; p++) part.masks[p][j] = (uint8_t)(mask >> (8 * p));
  }
  for (int64_t j = part.count; j % 64; j++)
    for (int p = 0; p < BLOCKS / 8; p++) part.masks[p][j] = 0;
}

// Composites the part's Gaussians into one block. Returns the index of the one that finished its last open pixel, or
// -1. A finished pixel has nothing left (0) and a floor below that (-1): it then drops out by itself. What it had is in
// final_t.
template <int K>
FS_INLINE int64_t composite(const TileJob& job, const Part<K>& part, int64_t start, int index, Block<K>& block,
                            float* final_t) {
  const vf log_min = set1(job.log_alpha_min), alpha_max = set1((float)job.view.alpha_max), half = set1(0.5f);
  const vf x = load(block.x), y = load(block.y);
  vf remaining = load(block.remaining), median = load(block.other), floor = load(block.extra), values[K];
  int64_t closed = -1;
  alignas(64) float alphas[64][W];
#pragma GCC unroll 20
  for (int k = 0; k < K; k++) values[k] = load(block.values[k]);
  for (int64_t base = 0; base < part.count && closed < 0; base += 64) {
    // Two loops: alphas, which take long but do not depend on each other, then the compositing, in order of depth.
    const float* list[64];
    int count = 0;
    for (uint64_t bits = column(part.masks[index / 8] + base, index % 8); bits; bits &= bits - 1) {
      const float *s = part.rows[base + __builtin_ctzll(bits)], *shape = s + Part<K>::SHAPE;
      const vf u = fma(set1(shape[0]), x, fma(set1(shape[1]), y, set1(s[Part<K>::U])));
      const vf v = fma(set1(shape[2]), y, set1(s[Part<K>::V]));
      const vf exponent = fnma(u, u, fnma(v, v, set1(shape[3])));
      store(alphas[count], keep(ge(exponent, log_min), vmin(exp2_normal(exponent), alpha_max)));
      list[count++] = s;
    }
    for (int n = 0; n < count; n++) {
      const float* features = list[n] + Part<K>::FEATURES;
      const vf alpha = load(alphas[n]);
      vf after = fnma(alpha, remaining, remaining);
      const vm ends = le(after, floor);
      if (__builtin_expect(any(ends), 0)) {
        const int64_t j = (list[n] - part.rows[0]) / Part<K>::ROW;
        store(final_t, select(ends, remaining, load(final_t)));
        storei(block.stop, selecti(ends, set1i((int32_t)(start + j)), loadi(block.stop)));
        floor = select(ends, set1(-1.0f), floor);
        remaining = select(ends, zero(), remaining);
        after = select(ends, zero(), after);
        if (!any(gt(remaining, zero()))) {
          closed = j;
          break;
        }
      }
      const vf weight = alpha * remaining;
#pragma GCC unroll 20
      for (int k = 0; k < K; k++) values[k] = fma(weight, set1(features[k]), values[k]);
      // The last Gaussian that finds more than half left is the one that crosses it, if any does (where none does, this
      // value is not used). Slot 0 is the depth.
      median = select(gt(remaining, half), set1(features[0]), median);
      remaining = after;
    }
  }
#pragma GCC unroll 20
  for (int k = 0; k < K; k++) store(block.values[k], values[k]);
  store(block.remaining, remaining);
  store(block.other, median);
  store(block.extra, floor);
  return closed;
}

// Leaves in each block its pixels' values and what remains of their transmittance; other: median depth.
template <int K>
FS_INLINE void composite_tile(const TileJob& job, const Tile& t, int32_t tile, Block<K>* blocks) {
  Part<K> part;
  float* final_t = job.final_t + (int64_t)tile * PIXELS;
  uint64_t open = start_pixels(t, blocks);  // extra: what a pixel must keep more of than
  const vf t_min = set1((float)job.view.transmittance_min);
  for (int b = 0; b < BLOCKS; b++) {
    const vm inside = gt(load(blocks[b].remaining), zero());
    store(blocks[b].remaining, keep(inside, set1(1.0f)));
    store(blocks[b].extra, select(inside, t_min, set1(-1.0f)));
    store(final_t + b * W, set1(1.0f));
  }
  int64_t used = 0;
  for (int64_t start = 0; start < t.count && open; start += PART) {
    gather(job, t, start, part);
    used = start + part.count;
    // Blocks leave the masks of the Gaussians behind the one that finished them: the backward pass need not look.
    uint64_t left[PART], running = open;
    bool any_closed = false;
    int64_t last = 0;
    for (int b = 0; b < BLOCKS; b++) {
      if (!(open >> b & 1)) continue;
      const int64_t closed = composite(job, part, start, b, blocks[b], final_t + b * W);
      if (closed < 0) continue;
      if (!any_closed) std::memset(left, 0, sizeof left);
      any_closed = true;
      left[closed] |= 1ull << b;
      last = closed > last ? closed : last;
      open &= ~(1ull << b);
    }
    if (!open) used = start + last + 1;
    if (any_closed || running != ALL_BLOCKS)
      for (int64_t j = 0; j < part.count; j++) {
        job.isects[t.begin + start + j].blocks &= running;
        if (any_closed) running &= ~left[j];
      }
  }
  job.tile_used[tile] = (int32_t)used;
  for (int b = 0; b < BLOCKS; b++) {
    const vf left = load(blocks[b].remaining), remaining = select(gt(left, zero()), left, load(final_t + b * W));
    store(blocks[b].remaining, remaining);
    store(final_t + b * W, remaining);
    storei(job.stop + (int64_t)tile * PIXELS + b * W, loadi(blocks[b].stop));
  }
}

}  // namespace FS_NS
