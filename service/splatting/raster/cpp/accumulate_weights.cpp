// Sums of blend weights times values, per Gaussian.
#include "pixels.h"

namespace FS_NS {

// Front to back like the forward pass, but adding up w·value(p) per Gaussian instead of w·feature per pixel.
template <int K>
static void accumulate_group(const TileJob& job, int32_t tile) {
  constexpr int SLOTS = (K + W - 1) / W * W;
  const Tile t = tile_of(job, tile);
  prefetch_pixels(t, job, job.grad_image);
  Block<K> blocks[BLOCKS];
  uint64_t open = start_pixels(t, blocks);
  for (int y = 0; y < t.height; y++)
    for (int x = 0; x < t.width; x++) {
      const int64_t pixel = (int64_t)(t.y0 + y) * job.view.width + t.x0 + x;
      const float* in = job.grad_image + pixel * job.channels + job.channel_begin;
      for (int c = 0; c < job.group; c++) blocks[block_of(x, y)].values[c][lane_of(x, y)] = in[c];
    }
  const vf log_min = set1(job.log_alpha_min), alpha_max = set1((float)job.view.alpha_max);
  const vf t_min = set1((float)job.view.transmittance_min);
  for (int64_t i = 0; i < t.count; i++) {
    if (i + AHEAD < t.count)
      prefetch(job.records + (int64_t)job.isects[t.begin + i + AHEAD].rank * job.stride, GEOMETRY);
    float* out = job.sums + (int64_t)job.isects[t.begin + i].slot * job.sum_stride + job.channel_begin;
    vf acc[SLOTS];
    for (int k = 0; k < SLOTS; k++) acc[k] = zero();
    const float* record = job.records + (int64_t)job.isects[t.begin + i].rank * job.stride;
    const Ellipse e = Ellipse::from(record, t.left, t.top);
    for (uint64_t bits = job.isects[t.begin + i].blocks & open; bits; bits &= bits - 1) {
      const int index = __builtin_ctzll(bits);
      Block<K>& block = blocks[index];
      vf u, v;
      const vf exponent = Ellipse::exponent(e, block, u, v);
      const vm hit = ge(exponent, log_min);
      const vf before = load(block.remaining);
      const vf alpha = vmin(exp2_normal(exponent), alpha_max);
      const vf after = fnma(alpha, before, before);
      const vm ok = both(hit, gt(after, t_min)), ends = but(hit, ok);
      const vf weight = keep(ok, alpha * before);
      for (int k = 0; k < K; k++) acc[k] = fma(weight, load(block.values[k]), acc[k]);
      const vf now = select(ends, negative(before), select(ok, after, before));
      store(block.remaining, now);
      if (__builtin_expect(any(ends), 0) && !any(gt(now, zero()))) open &= ~(1ull << index);
    }
    alignas(64) float totals[SLOTS];
    store_sums(acc, SLOTS, totals);
    for (int k = 0; k < job.group; k++) out[k] = totals[k];
  }
}

void accumulate_weights(const TileJob& job, int32_t tile) {
  with_slot_width(job.group, [&](auto width) { accumulate_group<decltype(width)::value>(job, tile); });
}

}  // namespace FS_NS
