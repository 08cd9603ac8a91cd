// The inner loops. A tile is 16×16 pixels in blocks of one vector (4 pixels wide, BLOCK_H high); state of all blocks
// lives in the first-level cache, Gaussians come in order of depth, and each visits only the blocks its ellipse touches.
#include "kernels.h"
#include "simd.h"

namespace FS_NS {
using namespace fs;

constexpr int BLOCKS = TILE * TILE / W;
constexpr int COLUMNS = TILE / 4;
constexpr int PIXELS = TILE * TILE;

// Offsets of each lane's pixel centre from the tile's first pixel centre.
struct Grid {
  alignas(64) float x[PIXELS], y[PIXELS];
  constexpr Grid() : x(), y() {
    for (int b = 0; b < BLOCKS; b++)
      for (int l = 0; l < W; l++) {
        x[b * W + l] = (float)((b % COLUMNS) * 4 + l % 4);
        y[b * W + l] = (float)((b / COLUMNS) * BLOCK_H + l / 4);
      }
  }
};
static constexpr Grid grid;

FS_INLINE int index_of(int x, int y) {
  return ((y / BLOCK_H) * COLUMNS + x / 4) * W + (y % BLOCK_H) * 4 + x % 4;
}

// One Gaussian as seen from one tile.
struct Ellipse {
  vf a, b, c, u, v, log_opacity;
  FS_INLINE Ellipse from(const float* record, double left, double top) {
    double center[2];
    std::memcpy(center, record, sizeof center);
    const double dx = left - center[0], dy = top - center[1];
    const double a = record[4], b = record[5], c = record[6];
    return {set1(record[4]), set1(record[5]), set1(record[6]), set1((float)(a * dx + b * dy)), set1((float)(c * dy)),
            set1(record[7])};
  }
  FS_INLINE vf exponent(const Ellipse& e, int at, vf& u, vf& v) {
    const vf y = load(grid.y + at);
    u = fma(e.a, load(grid.x + at), fma(e.b, y, e.u));
    v = fma(e.c, y, e.v);
    return fnma(u, u, fnma(v, v, e.log_opacity));
  }
};

struct Tile {
  int x0, y0, width, height;  // pixels inside the image
  double left, top;
  int64_t begin, count;
};

FS_INLINE Tile tile_of(const TileJob& job, int32_t tile) {
  Tile t;
  t.x0 = (tile % job.tiles_x) * TILE;
  t.y0 = (tile / job.tiles_x) * TILE;
  t.width = job.view.width - t.x0 < TILE ? job.view.width - t.x0 : TILE;
  t.height = job.view.height - t.y0 < TILE ? job.view.height - t.y0 : TILE;
  t.left = t.x0 + 0.5;
  t.top = t.y0 + 0.5;
  t.begin = job.tile_start[tile];
  t.count = job.tile_start[tile + 1] - t.begin;
  return t;
}


FS_INLINE vf negative(vf a) { return vabs(a) * set1(-1.0f); }

// Pixels start transparent, those outside the image finished. A finished pixel keeps its transmittance with a minus
// sign: every test "what would remain is above the limit" then fails by itself.
FS_INLINE void start_pixels(const Tile& t, float* remaining, int32_t* stop) {
  for (int y = 0; y < TILE; y++)
    for (int x = 0; x < TILE; x++) {
      const int i = index_of(x, y);
      const bool inside = x < t.width && y < t.height;
      remaining[i] = inside ? 1.0f : -1.0f;
      stop[i] = inside ? INT32_MAX : 0;
    }
}

FS_INLINE uint64_t open_blocks(const float* remaining) {
  uint64_t open = 0;
  for (int b = 0; b < BLOCKS; b++) open |= (uint64_t)any(gt(load(remaining + b * W), zero())) << b;
  return open;
}

template <int K>
static void forward_group(const TileJob& job, int32_t tile) {
  const Tile t = tile_of(job, tile);
  alignas(64) float sums[K][PIXELS];
  alignas(64) float median[PIXELS];
  float* remaining = job.final_t + (int64_t)tile * PIXELS;
  int32_t* stop = job.stop + (int64_t)tile * PIXELS;
  for (int k = 0; k < K; k++)
    for (int i = 0; i < PIXELS; i += W) store(sums[k] + i, zero());
  for (int i = 0; i < PIXELS; i += W) store(median + i, zero());
  start_pixels(t, remaining, stop);
  uint64_t open = open_blocks(remaining);
  const vf log_min = set1(std::log2((float)job.view.alpha_min)), alpha_max = set1((float)job.view.alpha_max);
  const vf t_min = set1((float)job.view.transmittance_min), half = set1(0.5f);
  const int offset = job.first ? GEOMETRY : GEOMETRY + 1 + job.channel_begin;
  int64_t i = 0;
  for (; i < t.count && open; i++) {
    const float* record = job.records + (int64_t)job.pair_rank[t.begin + i] * job.stride;
    const Ellipse e = Ellipse::from(record, t.left, t.top);
    uint64_t used = 0;
    for (uint64_t blocks = job.pair_blocks[t.begin + i] & open; blocks; blocks &= blocks - 1) {
      const int block = __builtin_ctzll(blocks), at = block * W;
      vf u, v;
      const vf exponent = Ellipse::exponent(e, at, u, v);
      const vm hit = ge(exponent, log_min);
      if (!any(hit)) continue;
      const vf before = load(remaining + at);
      const vf alpha = vmin(exp2(exponent), alpha_max);
      const vf after = fnma(alpha, before, before);
      const vm ok = both(hit, gt(after, t_min)), ends = but(hit, ok);
      const vf weight = keep(ok, alpha * before);
      for (int k = 0; k < K; k++) store(sums[k] + at, fma(weight, set1(record[offset + k]), load(sums[k] + at)));
      if (any(ok)) used |= 1ull << block;
      const vm crosses = both(both(ok, le(after, half)), gt(before, half));
      if (any(crosses)) store(median + at, select(crosses, set1(record[GEOMETRY]), load(median + at)));
      vf now = select(ok, after, before);
      if (any(ends)) {
        const vm fresh = both(ends, gt(before, zero()));
        storei(stop + at, selecti(fresh, set1i((int32_t)i), loadi(stop + at)));
        now = select(fresh, negative(before), now);
        if (!any(gt(now, zero()))) open &= ~(1ull << block);
      }
      store(remaining + at, now);
    }
    job.pair_blocks[t.begin + i] = used;
  }
  job.tile_used[tile] = (int32_t)i;
  for (int p = 0; p < PIXELS; p += W) store(remaining + p, vabs(load(remaining + p)));

  const int skip = job.first ? 1 : 0;  // slot 0 of the first group is depth
  for (int y = 0; y < t.height; y++)
    for (int x = 0; x < t.width; x++) {
      const int p = index_of(x, y);
      const int64_t pixel = (int64_t)(t.y0 + y) * job.view.width + t.x0 + x;
      float* out = job.image + pixel * job.channels + job.channel_begin;
      for (int c = 0; c < job.group; c++) out[c] = sums[c + skip][p] + remaining[p] * job.background[job.channel_begin + c];
      if (job.first) {
        job.alpha[pixel] = 1.0f - remaining[p];
        job.depth[pixel] = sums[0][p];
        job.median[pixel] = median[p];
      }
    }
}

template <int K>
static void backward_group(const TileJob& job, int32_t tile) {
  constexpr int SLOTS = (MOMENTS + K + W - 1) / W * W;
  const Tile t = tile_of(job, tile);
  alignas(64) float grads[K][PIXELS];
  alignas(64) float grad_alpha[PIXELS], behind[PIXELS], remaining[PIXELS];
  const float* final_t = job.final_t + (int64_t)tile * PIXELS;
  const int32_t* stop = job.stop + (int64_t)tile * PIXELS;
  const int skip = job.first ? 1 : 0;
  for (int i = 0; i < PIXELS; i += W) {
    for (int k = 0; k < K; k++) store(grads[k] + i, zero());
    store(grad_alpha + i, zero());
    store(behind + i, zero());
    store(remaining + i, load(final_t + i));
  }
  for (int y = 0; y < t.height; y++)
    for (int x = 0; x < t.width; x++) {
      const int p = index_of(x, y);
      const int64_t pixel = (int64_t)(t.y0 + y) * job.view.width + t.x0 + x;
      float back = 0;
      if (job.grad_image) {
        const float* in = job.grad_image + pixel * job.channels + job.channel_begin;
        for (int c = 0; c < job.group; c++) {
          grads[c + skip][p] = in[c];
          back += in[c] * job.background[job.channel_begin + c];
        }
      }
      behind[p] = final_t[p] * back;
      if (job.first && job.grad_depth) grads[0][p] = job.grad_depth[pixel];
      if (job.first && job.grad_alpha) grad_alpha[p] = job.grad_alpha[pixel];
    }
  const vf log_min = set1(std::log2((float)job.view.alpha_min)), alpha_max = set1((float)job.view.alpha_max);
  const vf one = set1(1.0f);
  const int offset = job.first ? GEOMETRY : GEOMETRY + 1 + job.channel_begin;
  const int place = job.first ? MOMENTS : MOMENTS + 1 + job.channel_begin, kept = job.group + skip;
  const int64_t used = job.tile_used[tile];
  for (int64_t i = t.count - 1; i >= 0; i--) {
    float* out = job.sums + (int64_t)job.pair_slot[t.begin + i] * job.sum_stride;
    uint64_t blocks = i < used ? job.pair_blocks[t.begin + i] : 0;
    if (!blocks) {
      if (job.first) for (int k = 0; k < MOMENTS; k++) out[k] = 0;
      for (int k = 0; k < kept; k++) out[place + k] = 0;
      continue;
    }
    const float* record = job.records + (int64_t)job.pair_rank[t.begin + i] * job.stride;
    const Ellipse e = Ellipse::from(record, t.left, t.top);
    vf acc[SLOTS];
    for (int k = 0; k < SLOTS; k++) acc[k] = zero();
    const vi now = set1i((int32_t)i);
    for (; blocks; blocks &= blocks - 1) {
      const int at = __builtin_ctzll(blocks) * W;
      vf u, v;
      const vf exponent = Ellipse::exponent(e, at, u, v);
      const vm on = both(ge(exponent, log_min), gti(loadi(stop + at), now));
      const vf raw = keep(on, exp2(exponent));
      const vf alpha = vmin(raw, alpha_max);
      const vf inverse = one / (one - alpha);
      const vf before = load(remaining + at) * inverse;
      const vf weight = alpha * before;
      vf dot = load(grad_alpha + at);
      for (int k = 0; k < K; k++) {
        const vf grad = load(grads[k] + at);
        dot = fma(set1(record[offset + k]), grad, dot);
        acc[MOMENTS + k] = fma(weight, grad, acc[MOMENTS + k]);
      }
      const vf rest = load(behind + at);
      const vf d_alpha = fnma(rest, inverse, before * dot);
      store(behind + at, fma(weight, dot, rest));
      store(remaining + at, before);
      const vf g = keep(le(raw, alpha_max), d_alpha * alpha);
      const vf gu = g * u, gv = g * v;
      acc[0] = acc[0] + g;
      acc[1] = acc[1] + gu;
      acc[2] = acc[2] + gv;
      acc[3] = fma(gu, u, acc[3]);
      acc[4] = fma(gu, v, acc[4]);
      acc[5] = fma(gv, v, acc[5]);
    }
    alignas(64) float totals[SLOTS];
    store_sums(acc, SLOTS, totals);
    if (job.first) {
      for (int k = 0; k < MOMENTS + kept; k++) out[k] = totals[k];
    } else {
      for (int k = 0; k < MOMENTS; k++) out[k] += totals[k];
      for (int k = 0; k < kept; k++) out[place + k] = totals[MOMENTS + k];
    }
  }
}

// Front to back like the forward pass, but adding up w·value(p) per Gaussian instead of w·feature per pixel.
template <int K>
static void blend_group(const TileJob& job, int32_t tile) {
  constexpr int SLOTS = (K + W - 1) / W * W;
  const Tile t = tile_of(job, tile);
  alignas(64) float values[K][PIXELS];
  alignas(64) float remaining[PIXELS];
  alignas(64) int32_t stop[PIXELS];
  for (int k = 0; k < K; k++)
    for (int i = 0; i < PIXELS; i += W) store(values[k] + i, zero());
  start_pixels(t, remaining, stop);
  for (int y = 0; y < t.height; y++)
    for (int x = 0; x < t.width; x++) {
      const int64_t pixel = (int64_t)(t.y0 + y) * job.view.width + t.x0 + x;
      const float* in = job.grad_image + pixel * job.channels + job.channel_begin;
      for (int c = 0; c < job.group; c++) values[c][index_of(x, y)] = in[c];
    }
  uint64_t open = open_blocks(remaining);
  const vf log_min = set1(std::log2((float)job.view.alpha_min)), alpha_max = set1((float)job.view.alpha_max);
  const vf t_min = set1((float)job.view.transmittance_min);
  for (int64_t i = 0; i < t.count; i++) {
    float* out = job.sums + (int64_t)job.pair_slot[t.begin + i] * job.sum_stride + job.channel_begin;
    uint64_t blocks = job.pair_blocks[t.begin + i] & open;
    vf acc[SLOTS];
    for (int k = 0; k < SLOTS; k++) acc[k] = zero();
    const float* record = job.records + (int64_t)job.pair_rank[t.begin + i] * job.stride;
    const Ellipse e = Ellipse::from(record, t.left, t.top);
    for (; blocks; blocks &= blocks - 1) {
      const int block = __builtin_ctzll(blocks), at = block * W;
      vf u, v;
      const vf exponent = Ellipse::exponent(e, at, u, v);
      const vm hit = ge(exponent, log_min);
      const vf before = load(remaining + at);
      const vf alpha = vmin(exp2(exponent), alpha_max);
      const vf after = fnma(alpha, before, before);
      const vm ok = both(hit, gt(after, t_min)), ends = but(hit, ok);
      const vf weight = keep(ok, alpha * before);
      for (int k = 0; k < K; k++) acc[k] = fma(weight, load(values[k] + at), acc[k]);
      const vf now = select(ends, negative(before), select(ok, after, before));
      store(remaining + at, now);
      if (any(ends) && !any(gt(now, zero()))) open &= ~(1ull << block);
    }
    alignas(64) float totals[SLOTS];
    store_sums(acc, SLOTS, totals);
    for (int k = 0; k < job.group; k++) out[k] = totals[k];
  }
}

// The smallest compiled width that holds the group; further slots read padding and are not written out.
#define FS_DISPATCH(FUNCTION, SLOTS_WANTED)             \
  const int wanted = SLOTS_WANTED;                      \
  if (wanted <= 1) return FUNCTION<1>(job, tile);       \
  if (wanted <= 4) return FUNCTION<4>(job, tile);       \
  if (wanted <= 5) return FUNCTION<5>(job, tile);       \
  if (wanted <= 7) return FUNCTION<7>(job, tile);       \
  if (wanted <= 8) return FUNCTION<8>(job, tile);       \
  if (wanted <= 9) return FUNCTION<9>(job, tile);       \
  if (wanted <= 12) return FUNCTION<12>(job, tile);     \
  return FUNCTION<17>(job, tile);

void forward(const TileJob& job, int32_t tile) { FS_DISPATCH(forward_group, job.group + job.first) }
void backward(const TileJob& job, int32_t tile) { FS_DISPATCH(backward_group, job.group + job.first) }
void blend(const TileJob& job, int32_t tile) { FS_DISPATCH(blend_group, job.group) }

}  // namespace FS_NS
