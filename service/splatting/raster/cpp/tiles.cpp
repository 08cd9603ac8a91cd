// The inner loops. A tile is 16×16 pixels in blocks of one vector (4 pixels wide, BLOCK_H high); state of all blocks
// lives in the first-level cache, Gaussians come in order of depth, and each visits only the blocks its ellipse touches.
#include "kernels.h"
#include "simd.h"

namespace FS_NS {
using namespace fs;

constexpr int BLOCKS = TILE * TILE / W;
constexpr int COLUMNS = TILE / 4;
constexpr int PIXELS = TILE * TILE;

// Everything about one block in one place: a single base register reaches all of it. x and y are the offsets of each
// lane's pixel centre from the tile's first one.
template <int K>
struct alignas(64) Block {
  float x[W], y[W], remaining[W], other[W], extra[W], values[K][W];
  int32_t stop[W];
};

template <int K>
FS_INLINE void start_blocks(Block<K>* blocks) {
  for (int b = 0; b < BLOCKS; b++) {
    std::memset(&blocks[b], 0, sizeof blocks[b]);
    for (int l = 0; l < W; l++) {
      blocks[b].x[l] = (float)((b % COLUMNS) * 4 + l % 4);
      blocks[b].y[l] = (float)((b / COLUMNS) * BLOCK_H + l / 4);
    }
  }
}

FS_INLINE int block_of(int x, int y) { return (y / BLOCK_H) * COLUMNS + x / 4; }
FS_INLINE int lane_of(int x, int y) { return (y % BLOCK_H) * 4 + x % 4; }

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
  template <int K>
  FS_INLINE vf exponent(const Ellipse& e, const Block<K>& block, vf& u, vf& v) {
    const vf y = load(block.y);
    u = fma(e.a, load(block.x), fma(e.b, y, e.u));
    v = fma(e.c, y, e.v);
    return fnma(u, u, fnma(v, v, e.log_opacity));
  }
};

// Records of one tile lie far apart in memory; asking for them early hides the way to the outer caches.
constexpr int64_t AHEAD = 8;
FS_INLINE void prefetch(const float* p, int64_t floats) {
  for (int64_t i = 0; i < floats; i += 16) __builtin_prefetch(p + i);
}

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
// sign: every test "what would remain is above the limit" then fails by itself. Returns the blocks with open pixels.
template <int K>
FS_INLINE uint64_t start_pixels(const Tile& t, Block<K>* blocks) {
  start_blocks(blocks);
  uint64_t open = 0;
  for (int y = 0; y < TILE; y++)
    for (int x = 0; x < TILE; x++) {
      const int b = block_of(x, y), l = lane_of(x, y);
      const bool inside = x < t.width && y < t.height;
      blocks[b].remaining[l] = inside ? 1.0f : -1.0f;
      blocks[b].stop[l] = inside ? INT32_MAX : 0;
      open |= (uint64_t)inside << b;
    }
  return open;
}

// Blocks to images, four pixels at a time. EXACT: the group is the first and fills its slots, so all loops unroll.
template <int K, bool EXACT>
static void write_pixels(const TileJob& job, const Tile& t, const Block<K>* blocks) {
  const int skip = EXACT || job.first ? 1 : 0, group = EXACT ? K - 1 : job.group;  // slot 0 of the first group is depth
  float background[K];
  for (int c = 0; c < group; c++) background[c] = job.background[job.channel_begin + c];
  for (int y = 0; y < t.height; y++)
    for (int x = 0; x < t.width; x += 4) {
      const Block<K>& block = blocks[block_of(x, y)];
      const int lane = lane_of(x, y), count = t.width - x < 4 ? t.width - x : 4;
      const int64_t pixel = (int64_t)(t.y0 + y) * job.view.width + t.x0 + x;
      float* out = job.image + pixel * job.channels + job.channel_begin;
      for (int i = 0; i < count; i++, out += job.channels) {
        const float remaining = block.remaining[lane + i];
        for (int c = 0; c < group; c++) out[c] = block.values[c + skip][lane + i] + remaining * background[c];
        if (!EXACT && !job.first) continue;
        job.alpha[pixel + i] = 1.0f - remaining;
        job.depth[pixel + i] = block.values[0][lane + i];
        job.median[pixel + i] = remaining > 0.5f ? 0.0f : block.other[lane + i];
      }
    }
}

// Gradients to blocks: the reverse.
template <int K, bool EXACT>
static void read_pixels(const TileJob& job, const Tile& t, Block<K>* blocks) {
  const int skip = EXACT || job.first ? 1 : 0, group = EXACT ? K - 1 : job.group;
  float background[K];
  for (int c = 0; c < group; c++) background[c] = job.background[job.channel_begin + c];
  for (int y = 0; y < t.height; y++)
    for (int x = 0; x < t.width; x += 4) {
      Block<K>& block = blocks[block_of(x, y)];
      const int lane = lane_of(x, y), count = t.width - x < 4 ? t.width - x : 4;
      const int64_t pixel = (int64_t)(t.y0 + y) * job.view.width + t.x0 + x;
      const float* in = job.grad_image + pixel * job.channels + job.channel_begin;
      for (int i = 0; i < count; i++) {
        float back = 0;
        if (job.grad_image) {
          for (int c = 0; c < group; c++) {
            block.values[c + skip][lane + i] = in[c];
            back += in[c] * background[c];
          }
          in += job.channels;
        }
        block.other[lane + i] = block.remaining[lane + i] * back;
        if (job.first && job.grad_depth) block.values[0][lane + i] = job.grad_depth[pixel + i];
        if (job.first && job.grad_alpha) block.extra[lane + i] = job.grad_alpha[pixel + i];
      }
    }
}

template <int K>
static void forward_group(const TileJob& job, int32_t tile) {
  const Tile t = tile_of(job, tile);
  Block<K> blocks[BLOCKS];  // other: median depth
  uint64_t open = start_pixels(t, blocks);
  const vf log_min = set1(job.log_alpha_min), alpha_max = set1((float)job.view.alpha_max);
  const vf t_min = set1((float)job.view.transmittance_min), half = set1(0.5f);
  const int offset = job.first ? GEOMETRY : GEOMETRY + 1 + job.channel_begin;
  int64_t i = 0;
  for (; i < t.count && open; i++) {
    if (i + AHEAD < t.count) prefetch(job.records + (int64_t)job.pair_rank[t.begin + i + AHEAD] * job.stride, job.stride);
    const float* record = job.records + (int64_t)job.pair_rank[t.begin + i] * job.stride;
    const float* features = record + offset;
    const Ellipse e = Ellipse::from(record, t.left, t.top);
    const uint64_t used = job.pair_blocks[t.begin + i] & open;
    for (uint64_t bits = used; bits; bits &= bits - 1) {
      const int index = __builtin_ctzll(bits);
      Block<K>& block = blocks[index];
      vf u, v;
      const vf exponent = Ellipse::exponent(e, block, u, v);
      const vm hit = ge(exponent, log_min);
      const vf before = load(block.remaining);
      const vf alpha = vmin(exp2(exponent), alpha_max);
      const vf after = fnma(alpha, before, before);
      const vm ok = both(hit, gt(after, t_min)), ends = but(hit, ok);
      const vf weight = keep(ok, alpha * before);
      for (int k = 0; k < K; k++) store(block.values[k], fma(weight, set1(features[k]), load(block.values[k])));
      // The last Gaussian that finds more than half left is the one that crosses it, if any does.
      store(block.other, select(both(ok, gt(before, half)), set1(record[GEOMETRY]), load(block.other)));
      vf now = select(ok, after, before);
      if (__builtin_expect(any(ends), 0)) {
        const vm fresh = both(ends, gt(before, zero()));
        storei(block.stop, selecti(fresh, set1i((int32_t)i), loadi(block.stop)));
        now = select(fresh, negative(before), now);
        if (!any(gt(now, zero()))) open &= ~(1ull << index);
      }
      store(block.remaining, now);
    }
    job.pair_blocks[t.begin + i] = used;
  }
  job.tile_used[tile] = (int32_t)i;
  for (int b = 0; b < BLOCKS; b++) {
    const vf remaining = vabs(load(blocks[b].remaining));
    store(blocks[b].remaining, remaining);
    store(job.final_t + (int64_t)tile * PIXELS + b * W, remaining);
    storei(job.stop + (int64_t)tile * PIXELS + b * W, loadi(blocks[b].stop));
  }

  if (job.first && job.group == K - 1) {
    write_pixels<K, true>(job, t, blocks);
  } else {
    write_pixels<K, false>(job, t, blocks);
  }
}

// A tile's rows of an image [H, W, channels] are far apart too.
FS_INLINE void prefetch_pixels(const Tile& t, const TileJob& job, const float* image) {
  for (int y = 0; image && y < t.height; y++)
    prefetch(image + ((int64_t)(t.y0 + y) * job.view.width + t.x0) * job.channels, (int64_t)t.width * job.channels);
}

template <int K>
static void backward_group(const TileJob& job, int32_t tile) {
  constexpr int SLOTS = (MOMENTS + K + W - 1) / W * W;
  const Tile t = tile_of(job, tile);
  prefetch_pixels(t, job, job.grad_image);
  Block<K> blocks[BLOCKS];  // other: what lies behind, times its gradient; extra: gradient of alpha
  start_blocks(blocks);
  const int skip = job.first ? 1 : 0;
  for (int b = 0; b < BLOCKS; b++) {
    store(blocks[b].remaining, load(job.final_t + (int64_t)tile * PIXELS + b * W));
    storei(blocks[b].stop, loadi(job.stop + (int64_t)tile * PIXELS + b * W));
  }
  if (job.first && job.group == K - 1) {
    read_pixels<K, true>(job, t, blocks);
  } else {
    read_pixels<K, false>(job, t, blocks);
  }
  const vf log_min = set1(job.log_alpha_min), alpha_max = set1((float)job.view.alpha_max);
  const vf one = set1(1.0f);
  const int offset = job.first ? GEOMETRY : GEOMETRY + 1 + job.channel_begin;
  const int place = job.first ? MOMENTS : MOMENTS + 1 + job.channel_begin, kept = job.group + skip;
  const bool whole = job.first && job.sum_stride >= SLOTS;
  const int64_t used = job.tile_used[tile];
  for (int64_t i = t.count - 1; i >= 0; i--) {
    if (i >= AHEAD) {
      prefetch(job.records + (int64_t)job.pair_rank[t.begin + i - AHEAD] * job.stride, job.stride);
      __builtin_prefetch(job.sums + (int64_t)job.pair_slot[t.begin + i - AHEAD] * job.sum_stride, 1);
    }
    float* out = job.sums + (int64_t)job.pair_slot[t.begin + i] * job.sum_stride;
    uint64_t bits = i < used ? job.pair_blocks[t.begin + i] : 0;
    if (!bits) {
      if (job.first) for (int k = 0; k < MOMENTS; k++) out[k] = 0;
      for (int k = 0; k < kept; k++) out[place + k] = 0;
      continue;
    }
    const float* record = job.records + (int64_t)job.pair_rank[t.begin + i] * job.stride;
    const float* features = record + offset;
    const Ellipse e = Ellipse::from(record, t.left, t.top);
    vf acc[SLOTS];
    for (int k = 0; k < SLOTS; k++) acc[k] = zero();
    const vi now = set1i((int32_t)i);
    for (; bits; bits &= bits - 1) {
      Block<K>& block = blocks[__builtin_ctzll(bits)];
      vf u, v;
      const vf exponent = Ellipse::exponent(e, block, u, v);
      const vm on = both(ge(exponent, log_min), gti(loadi(block.stop), now));
      const vf raw = keep(on, exp2(exponent));
      const vf alpha = vmin(raw, alpha_max);
      const vf inverse = one / (one - alpha);
      const vf before = load(block.remaining) * inverse;
      const vf weight = alpha * before;
      vf dot = load(block.extra);
      for (int k = 0; k < K; k++) {
        const vf grad = load(block.values[k]);
        dot = fma(set1(features[k]), grad, dot);
        acc[MOMENTS + k] = fma(weight, grad, acc[MOMENTS + k]);
      }
      const vf rest = load(block.other);
      const vf d_alpha = fnma(rest, inverse, before * dot);
      store(block.other, fma(weight, dot, rest));
      store(block.remaining, before);
      const vf g = keep(le(raw, alpha_max), d_alpha * alpha);
      const vf gu = g * u, gv = g * v;
      acc[0] = acc[0] + g;
      acc[1] = acc[1] + gu;
      acc[2] = acc[2] + gv;
      acc[3] = fma(gu, u, acc[3]);
      acc[4] = fma(gu, v, acc[4]);
      acc[5] = fma(gv, v, acc[5]);
    }
    if (whole) {
      store_sums(acc, SLOTS, out);
      continue;
    }
    alignas(64) float totals[SLOTS];
    store_sums(acc, SLOTS, totals);
    for (int k = 0; k < MOMENTS; k++) out[k] = job.first ? totals[k] : out[k] + totals[k];
    for (int k = 0; k < kept; k++) out[place + k] = totals[MOMENTS + k];
  }
}

// Front to back like the forward pass, but adding up w·value(p) per Gaussian instead of w·feature per pixel.
template <int K>
static void blend_group(const TileJob& job, int32_t tile) {
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
    if (i + AHEAD < t.count) prefetch(job.records + (int64_t)job.pair_rank[t.begin + i + AHEAD] * job.stride, GEOMETRY);
    float* out = job.sums + (int64_t)job.pair_slot[t.begin + i] * job.sum_stride + job.channel_begin;
    vf acc[SLOTS];
    for (int k = 0; k < SLOTS; k++) acc[k] = zero();
    const float* record = job.records + (int64_t)job.pair_rank[t.begin + i] * job.stride;
    const Ellipse e = Ellipse::from(record, t.left, t.top);
    for (uint64_t bits = job.pair_blocks[t.begin + i] & open; bits; bits &= bits - 1) {
      const int index = __builtin_ctzll(bits);
      Block<K>& block = blocks[index];
      vf u, v;
      const vf exponent = Ellipse::exponent(e, block, u, v);
      const vm hit = ge(exponent, log_min);
      const vf before = load(block.remaining);
      const vf alpha = vmin(exp2(exponent), alpha_max);
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
