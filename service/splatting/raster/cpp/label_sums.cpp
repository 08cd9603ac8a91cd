// Sums of blend weights by label, per Gaussian of a tile.
#include "composite.h"

namespace FS_NS {

// The labels of a tile by their first occurrence, and which of them each block shows.
struct TileLabels {
  alignas(64) int32_t local[PIXELS];  // block order; -1: does not count
  int32_t names[PIXELS];
  int16_t shown[BLOCKS][W];
  uint8_t count[BLOCKS];
  bool pure[BLOCKS];  // one label, and every pixel counts
  int32_t distinct;
};

FS_INLINE void read_labels(const TileJob& job, const Tile& t, const int32_t* labels, TileLabels& out) {
  std::memset(out.local, -1, sizeof out.local);
  out.distinct = 0;
  int32_t last = -1;  // patches: most pixels have the label of their neighbor
  for (int y = 0; y < t.height; y++)
    for (int x = 0; x < t.width; x++) {
      const int32_t label = labels[(int64_t)(t.y0 + y) * job.view.width + t.x0 + x];
      if (label < 0) continue;
      if (last < 0 || out.names[last] != label) {
        for (last = 0; last < out.distinct && out.names[last] != label;) last++;
        if (last == out.distinct) out.names[out.distinct++] = label;
      }
      out.local[block_of(x, y) * W + lane_of(x, y)] = last;
    }
  for (int b = 0; b < BLOCKS; b++) {
    int n = 0;
    bool whole = true;
    for (int l = 0; l < W; l++) {
      const int32_t id = out.local[b * W + l];
      int i = 0;
      while (i < n && out.shown[b][i] != id) i++;
      if (id >= 0 && i == n) out.shown[b][n++] = (int16_t)id;
      whole &= id >= 0;
    }
    out.count[b] = (uint8_t)n;
    out.pure[b] = whole && n == 1;
  }
}

bool label_sums(const TileJob& job, const int32_t* labels, LabelWeightList& weights, int32_t tile) {
  const Tile t = tile_of(job, tile);
  Block<1> blocks[BLOCKS];
  TileLabels tile_labels;
  alignas(64) float sums[PIXELS][W];  // by local label; only those of `touched` hold anything
  int64_t stamp[PIXELS];
  int16_t touched[PIXELS];
  uint64_t open = start_pixels(t, blocks);
  read_labels(job, t, labels, tile_labels);
  if (!tile_labels.distinct) return true;
  for (int i = 0; i < tile_labels.distinct; i++) stamp[i] = -1;
  const vf log_min = set1(job.log_alpha_min), alpha_max = set1((float)job.view.alpha_max);
  const vf t_min = set1((float)job.view.transmittance_min);
  for (int64_t i = 0; i < t.count && open; i++) {
    if (i + AHEAD < t.count)
      prefetch(job.records + (int64_t)job.isects[t.begin + i + AHEAD].rank * job.stride, GEOMETRY);
    const Ellipse e = Ellipse::from(job.records + (int64_t)job.isects[t.begin + i].rank * job.stride, t.left, t.top);
    int count = 0;
    for (uint64_t bits = job.isects[t.begin + i].blocks & open; bits; bits &= bits - 1) {
      const int index = __builtin_ctzll(bits);
      Block<1>& block = blocks[index];
      vf u, v;
      const vf exponent = Ellipse::exponent(e, block, u, v);
      const vm hit = ge(exponent, log_min);
      const vf before = load(block.remaining);
      const vf alpha = vmin(exp2_normal(exponent), alpha_max);
      const vf after = fnma(alpha, before, before);
      const vm ok = both(hit, gt(after, t_min)), ends = but(hit, ok);
      const vf weight = keep(ok, alpha * before);
      const vf now = select(ends, negative(before), select(ok, after, before));
      store(block.remaining, now);
      if (__builtin_expect(any(ends), 0) && !any(gt(now, zero()))) open &= ~(1ull << index);
      for (int s = 0; s < tile_labels.count[index]; s++) {
        const int16_t id = tile_labels.shown[index][s];
        const vf part =
            tile_labels.pure[index] ? weight : keep(eqi(loadi(tile_labels.local + index * W), set1i(id)), weight);
        if (stamp[id] != i) {
          stamp[id] = i;
          touched[count++] = id;
          store(sums[id], part);
        } else {
          store(sums[id], load(sums[id]) + part);
        }
      }
    }
    if (weights.count + count > weights.capacity && !weights.grow(weights)) return false;
    for (int n = 0; n < count; n++) {
      const float total = sum(load(sums[touched[n]]));
      weights.data[weights.count] = {job.isects[t.begin + i].slot, tile_labels.names[touched[n]], total};
      weights.count += total > 0;
    }
  }
  return true;
}

}  // namespace FS_NS
