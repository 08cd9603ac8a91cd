// The class of every pixel of a tile, from the code composited there.
#include "composite.h"

namespace FS_NS {

constexpr float LOGIT_LIMIT = 1e30f, LOG2_E = 1.4426950408889634f;

// code: `size` vectors, one lane a pixel.
FS_INLINE vf logit_of(const LabelMapJob& job, const float* code, int32_t k) {
  const float* weight = job.weight + (int64_t)k * job.size;
  vf logit = set1(job.bias[k]);
  for (int d = 0; d < job.size; d++) logit = fma(set1(weight[d]), load(code + d * W), logit);
  return vmin(vmax(logit, set1(-LOGIT_LIMIT)), set1(LOGIT_LIMIT));
}

// Logits are computed a second time for the softmax: ten thousand of them have no place to wait.
FS_INLINE vi classify(const LabelMapJob& job, const float* code, float* expected) {
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
static void label_group(const TileJob& job, const LabelMapJob& labels, int32_t tile) {
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
    vi label = set1i(0);
    if (any(covered) || labels.relevancy) label = classify(labels, values + labels.skip * W, expected);
    storei(winner, selecti(covered, label, set1i(0)));
    const int columns = t.width - x0 < 4 ? t.width - x0 : 4;
    for (int y = 0; y < BLOCK_H && y0 + y < t.height; y++) {
      const int64_t pixel = (int64_t)(t.y0 + y0 + y) * job.view.width + t.x0 + x0;
      for (int x = 0; x < columns; x++) {
        labels.winner[pixel + x] = winner[y * 4 + x];
        labels.alpha[pixel + x] = alpha[y * 4 + x];
        if (labels.relevancy) labels.expected[pixel + x] = expected[y * 4 + x];
        for (int c = 0; c < labels.skip; c++) labels.image[(pixel + x) * labels.skip + c] = values[c * W + y * 4 + x];
      }
    }
  }
}

void label_map(const TileJob& job, const LabelMapJob& labels, int32_t tile) {
  with_slot_width(job.group + 1, [&](auto width) { label_group<decltype(width)::value>(job, labels, tile); });
}

}  // namespace FS_NS
