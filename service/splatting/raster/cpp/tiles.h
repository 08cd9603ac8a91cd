// What the inner loops share. A tile is TILE_W×TILE_H pixels in blocks of one vector (4 pixels wide, BLOCK_H high);
// state of all blocks lives in the first-level cache, Gaussians come in order of depth, each only to the blocks its
// ellipse touches.
#pragma once
#include "kernels.h"
#include "simd.h"

namespace FS_NS {
using namespace fs;

constexpr int PIXELS = TILE_W * TILE_H;
constexpr int BLOCKS = PIXELS / W;
constexpr int COLUMNS = TILE_W / 4;
constexpr uint64_t ALL_BLOCKS = ~0ull >> (64 - BLOCKS);

// Everything about one block in one place: a single base register reaches all of it. x and y are the offsets of each
// lane's pixel center from the tile's first one.
template <int K>
struct alignas(64) Block {
  float x[W], y[W], remaining[W], other[W], extra[W], values[K][W];
  int32_t stop[W];
};

template <int K>
FS_INLINE void start_blocks(Block<K>* blocks) {
  alignas(64) float x[W], y[W];
  for (int l = 0; l < W; l++) {
    x[l] = (float)(l % 4);
    y[l] = (float)(l / 4);
  }
  std::memset(blocks, 0, BLOCKS * sizeof blocks[0]);
  for (int b = 0; b < BLOCKS; b++) {
    store(blocks[b].x, load(x) + set1((float)((b % COLUMNS) * 4)));
    store(blocks[b].y, load(y) + set1((float)((b / COLUMNS) * BLOCK_H)));
  }
}

FS_INLINE int block_of(int x, int y) { return (y / BLOCK_H) * COLUMNS + x / 4; }
FS_INLINE int lane_of(int x, int y) { return (y % BLOCK_H) * 4 + x % 4; }

// Whitened offsets of a tile's first pixel center from a Gaussian, in doubles: their terms may cancel.
FS_INLINE void offsets(const float* record, double left, double top, float& u, float& v) {
  double center[2];
  std::memcpy(center, record, sizeof center);
  const double dx = left - center[0], dy = top - center[1];
  u = (float)((double)record[4] * dx + (double)record[5] * dy);
  v = (float)((double)record[6] * dy);
}

// One Gaussian as seen from one tile.
struct Ellipse {
  vf a, b, c, u, v, log_opacity;
  FS_INLINE Ellipse from(const float* record, double left, double top) {
    float u, v;
    offsets(record, left, top, u, v);
    return {set1(record[4]), set1(record[5]), set1(record[6]), set1(u), set1(v), set1(record[7])};
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
  t.x0 = (tile % job.tiles_x) * TILE_W;
  t.y0 = (tile / job.tiles_x) * TILE_H;
  t.width = job.view.width - t.x0 < TILE_W ? job.view.width - t.x0 : TILE_W;
  t.height = job.view.height - t.y0 < TILE_H ? job.view.height - t.y0 : TILE_H;
  t.left = t.x0 + 0.5;
  t.top = t.y0 + 0.5;
  t.begin = job.tile_start[tile];
  t.count = job.tile_start[tile + 1] - t.begin;
  return t;
}

// A tile's rows of an image [H, W, channels] are far apart too.
FS_INLINE void prefetch_pixels(const Tile& t, const TileJob& job, const float* image) {
  for (int y = 0; image && y < t.height; y++)
    prefetch(image + ((int64_t)(t.y0 + y) * job.view.width + t.x0) * job.channels, (int64_t)t.width * job.channels);
}

FS_INLINE vf negative(vf a) { return vabs(a) * set1(-1.0f); }

// Pixels start transparent, those outside the image finished. A finished pixel keeps its transmittance with a minus
// sign: every test "what would remain is above the limit" then fails by itself. Returns the blocks with open pixels.
template <int K>
FS_INLINE uint64_t start_pixels(const Tile& t, Block<K>* blocks) {
  start_blocks(blocks);
  if (t.width == TILE_W && t.height == TILE_H) {
    for (int b = 0; b < BLOCKS; b++) {
      store(blocks[b].remaining, set1(1.0f));
      storei(blocks[b].stop, set1i(INT32_MAX));
    }
    return ALL_BLOCKS;
  }
  uint64_t open = 0;
  for (int y = 0; y < TILE_H; y++)
    for (int x = 0; x < TILE_W; x++) {
      const int b = block_of(x, y), l = lane_of(x, y);
      const bool inside = x < t.width && y < t.height;
      blocks[b].remaining[l] = inside ? 1.0f : -1.0f;
      blocks[b].stop[l] = inside ? INT32_MAX : 0;
      open |= (uint64_t)inside << b;
    }
  return open;
}

template <int K>
struct SlotWidth {
  static constexpr int value = K;
};

// Calls body(SlotWidth<K>()) for the smallest compiled width K that holds `slots`. By recursion, and not by
// std::index_sequence: see simd.h.
template <int I = 0, class Body>
FS_INLINE void with_slot_width(int slots, const Body& body) {
  if constexpr (I + 1 < SLOT_WIDTH_COUNT)
    if (slots > SLOT_WIDTHS[I]) return with_slot_width<I + 1>(slots, body);
  body(SlotWidth<SLOT_WIDTHS[I]>());
}

}  // namespace FS_NS
