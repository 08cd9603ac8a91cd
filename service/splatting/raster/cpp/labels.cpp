// Labels of pixels from composited codes, and sums of blend weights by label.
#include "composite.h"

namespace FS_NS {

constexpr float LOGIT_LIMIT = 1e30f, LOG2_E = 1.4426950408889634f;

// code: `size` vectors, one lane a pixel.
FS_INLINE vf logit_of(const LabelJob& job, const float* code, int32_t k) {
  const float* weight = job.weight + (int64_t)k * job.size;
  vf logit = set1(job.bias[k]);
  for (int d = 0; d < job.size; d++) logit = fma(set1(weight[d]), load(code + d * W), logit);
  return vmin(vmax(logit, set1(-LOGIT_LIMIT)), set1(LOGIT_LIMIT));
}

// Logits are computed a second time for the softmax: ten thousand of them have no place to wait.
FS_INLINE vi classify(const LabelJob& job, const float* code, float* expected) {
  vf top = logit_of(job, code, 0);
  vi winner = set1i(0);
  for (int32_t k = 1; k < job.classes; k++) {
    const vf logit = logit_of(job, code, k);
    const vm more = gt(logit, top);
    top = select(more, logit, top);
    winner = selecti(more, set1i(k), winner);
  }
  if (job.relevancy) {
    vf total = zero(), sum = zero();
    for (int32_t k = 0; k < job.classes; k++) {
      const vf share = exp2((logit_of(job, code, k) - top) * set1(LOG2_E));
      total = total + share;
      sum = fma(share, set1(job.relevancy[k]), sum);
    }
    store(expected, sum / total);
  }
  return winner;
}

template <int K>
static void label_group(const TileJob& job, const LabelJob& labels, int32_t tile) {
  const Tile t = tile_of(job, tile);
  Block<K> blocks[BLOCKS];
  composite_tile(job, t, tile, blocks);
  for (int index = 0; index < BLOCKS; index++) {
    const int x0 = (index % COLUMNS) * 4, y0 = (index / COLUMNS) * BLOCK_H;
    if (x0 >= t.width || y0 >= t.height) continue;
    const float* values = blocks[index].values[1 % K];  // slot 0 is the depth
    alignas(64) float alpha[W], expected[W];
    alignas(64) int32_t winner[W];
    store(alpha, set1(1.0f) - load(blocks[index].remaining));
    const vm covered = ge(load(alpha), set1(labels.alpha_min));
    vi found = set1i(0);
    if (any(covered) || labels.relevancy) found = classify(labels, values + labels.skip * W, expected);
    storei(winner, selecti(covered, found, set1i(0)));
    const int columns = t.width - x0 < 4 ? t.width - x0 : 4;
    for (int y = 0; y < BLOCK_H && y0 + y < t.height; y++) {
      const int64_t pixel = (int64_t)(t.y0 + y0 + y) * job.view.width + t.x0 + x0;
      for (int x = 0; x < columns; x++) {
        labels.winner[pixel + x] = winner[y * 4 + x];
        labels.alpha[pixel + x] = alpha[y * 4 + x];
        if (labels.relevancy) labels.expected[pixel + x] = expected[y * 4 + x];
        for (int c = 0; c < labels.skip; c++)
          labels.image[(pixel + x) * labels.skip + c] = values[c * W + y * 4 + x];
      }
    }
  }
}

void label_tile(const TileJob& job, const LabelJob& labels, int32_t tile) {
#define FS_LABELS(K) if (job.group + 1 <= K) return label_group<K>(job, labels, tile);
  FS_LABELS(1) FS_LABELS(4) FS_LABELS(5) FS_LABELS(7) FS_LABELS(9) FS_LABELS(12) FS_LABELS(17)
#undef FS_LABELS
}

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
  int32_t last = -1;  // patches: most pixels have the label of their neighbour
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

bool label_sums(const TileJob& job, const int32_t* labels, LabelEntries& entries, int32_t tile) {
  const Tile t = tile_of(job, tile);
  Block<1> blocks[BLOCKS];
  TileLabels seen;
  alignas(64) float sums[PIXELS][W];  // by local label; only those of `touched` hold anything
  int64_t stamp[PIXELS];
  int16_t touched[PIXELS];
  uint64_t open = start_pixels(t, blocks);
  read_labels(job, t, labels, seen);
  if (!seen.distinct) return true;
  for (int i = 0; i < seen.distinct; i++) stamp[i] = -1;
  const vf log_min = set1(job.log_alpha_min), alpha_max = set1((float)job.view.alpha_max);
  const vf t_min = set1((float)job.view.transmittance_min);
  for (int64_t i = 0; i < t.count && open; i++) {
    if (i + AHEAD < t.count) prefetch(job.records + (int64_t)job.pairs[t.begin + i + AHEAD].rank * job.stride, GEOMETRY);
    const Ellipse e = Ellipse::from(job.records + (int64_t)job.pairs[t.begin + i].rank * job.stride, t.left, t.top);
    int count = 0;
    for (uint64_t bits = job.pairs[t.begin + i].blocks & open; bits; bits &= bits - 1) {
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
      for (int s = 0; s < seen.count[index]; s++) {
        const int16_t id = seen.shown[index][s];
        const vf part = seen.pure[index] ? weight : keep(eqi(loadi(seen.local + index * W), set1i(id)), weight);
        if (stamp[id] != i) {
          stamp[id] = i;
          touched[count++] = id;
          store(sums[id], part);
        } else {
          store(sums[id], load(sums[id]) + part);
        }
      }
    }
    if (entries.count + count > entries.capacity && !entries.grow(entries)) return false;
    for (int n = 0; n < count; n++) {
      const float total = sum(load(sums[touched[n]]));
      entries.data[entries.count] = {job.pairs[t.begin + i].slot, seen.names[touched[n]], total};
      entries.count += total > 0;
    }
  }
  return true;
}

}  // namespace FS_NS
