// Between blocks and images [H, W, channels]: four pixels of a row at a time, turned over in registers.
#pragma once
#include "tiles.h"

namespace FS_NS {
using namespace fs;

typedef float v4 __attribute__((vector_size(16)));
typedef int32_t i4 __attribute__((vector_size(16)));
typedef double d2 __attribute__((vector_size(16)));
FS_INLINE v4 load4(const float* p) { return *(const v4*)p; }
FS_INLINE void store4(float* p, v4 a) { *(v4*)p = a; }

// The values of four pixels that are neighbors in memory, `channels` apart: in[c] has channel c of each.
template <int C>
FS_INLINE void scatter4(const v4* in, int64_t channels, float* out) {
  for (int c = 0; c + 1 < C; c += 2) {
    const v4 low = __builtin_shuffle(in[c], in[c + 1], i4{0, 4, 1, 5}),
             high = __builtin_shuffle(in[c], in[c + 1], i4{2, 6, 3, 7});
    std::memcpy(out + c, &low, 8);
    std::memcpy(out + c + channels, (const char*)&low + 8, 8);
    std::memcpy(out + c + 2 * channels, &high, 8);
    std::memcpy(out + c + 3 * channels, (const char*)&high + 8, 8);
  }
  if (C % 2)
    for (int i = 0; i < 4; i++) out[C - 1 + i * channels] = in[C - 1][i];
}

template <int C>
FS_INLINE void gather4(const float* in, int64_t channels, v4* out) {
  for (int c = 0; c + 1 < C; c += 2) {
    double pair[4];  // two floats each; built as doubles so that nothing passes through memory
    for (int i = 0; i < 4; i++) std::memcpy(pair + i, in + c + i * channels, 8);
    const v4 low = (v4)d2{pair[0], pair[1]}, high = (v4)d2{pair[2], pair[3]};
    out[c] = __builtin_shuffle(low, high, i4{0, 2, 4, 6});
    out[c + 1] = __builtin_shuffle(low, high, i4{1, 3, 5, 7});
  }
  if (C % 2)
    for (int i = 0; i < 4; i++) out[C - 1][i] = in[C - 1 + i * channels];
}

// Whole fours of the first group with all its slots in use go the fast way; what is left goes pixel by pixel.
template <int K>
static void write_pixels(const TileJob& job, const Tile& t, const Block<K>* blocks) {
  const int skip = job.first ? 1 : 0, group = job.group;  // slot 0 of the first group is depth
  const bool whole = job.first && group == K - 1;
  float background[K];
  for (int c = 0; c < group; c++) background[c] = job.background[job.channel_begin + c];
  for (int y = 0; y < t.height; y++)
    for (int x = 0; x < t.width; x += 4) {
      const Block<K>& block = blocks[block_of(x, y)];
      const int lane = lane_of(x, y), count = t.width - x < 4 ? t.width - x : 4;
      const int64_t pixel = (int64_t)(t.y0 + y - job.first_row) * job.view.width + t.x0 + x;
      float* out = job.image + pixel * job.channels + job.channel_begin;
      if (whole && count == 4) {
        const v4 remaining = load4(block.remaining + lane);
        v4 values[K];
        for (int c = 0; c < K - 1; c++) values[c] = load4(block.values[c + 1] + lane) + remaining * background[c];
        scatter4<K - 1>(values, job.channels, out);
        const v4 alpha = 1.0f - remaining, depth = load4(block.values[0] + lane), other = load4(block.other + lane);
        const v4 median = remaining > 0.5f ? v4{} : other;
        std::memcpy(job.alpha + pixel, &alpha, 16);
        std::memcpy(job.depth + pixel, &depth, 16);
        std::memcpy(job.median + pixel, &median, 16);
        continue;
      }
      for (int i = 0; i < count; i++, out += job.channels) {
        const float remaining = block.remaining[lane + i];
        for (int c = 0; c < group; c++) out[c] = block.values[c + skip][lane + i] + remaining * background[c];
        if (!job.first) continue;
        job.alpha[pixel + i] = 1.0f - remaining;
        job.depth[pixel + i] = block.values[0][lane + i];
        job.median[pixel + i] = remaining > 0.5f ? 0.0f : block.other[lane + i];
      }
    }
}

// Gradients to blocks: the reverse. other: what the background would add to the loss per unit of transmittance.
template <int K>
static void read_pixels(const TileJob& job, const Tile& t, Block<K>* blocks) {
  const int skip = job.first ? 1 : 0, group = job.group;
  const bool whole = job.first && group == K - 1 && job.grad_image;
  float background[K];
  for (int c = 0; c < group; c++) background[c] = job.background[job.channel_begin + c];
  for (int y = 0; y < t.height; y++)
    for (int x = 0; x < t.width; x += 4) {
      Block<K>& block = blocks[block_of(x, y)];
      const int lane = lane_of(x, y), count = t.width - x < 4 ? t.width - x : 4;
      const int64_t pixel = (int64_t)(t.y0 + y) * job.view.width + t.x0 + x;
      const float* in = job.grad_image + pixel * job.channels + job.channel_begin;
      if (whole && count == 4) {
        v4 grads[K], back = v4{};
        gather4<K - 1>(in, job.channels, grads);
        for (int c = 0; c < K - 1; c++) {
          store4(block.values[c + 1] + lane, grads[c]);
          back += grads[c] * background[c];
        }
        store4(block.other + lane, back);
      } else {
        for (int i = 0; i < count && job.grad_image; i++, in += job.channels) {
          float back = 0;
          for (int c = 0; c < group; c++) {
            block.values[c + skip][lane + i] = in[c];
            back += in[c] * background[c];
          }
          block.other[lane + i] = back;
        }
      }
      for (int i = 0; i < count && job.first && job.grad_depth; i++)
        block.values[0][lane + i] = job.grad_depth[pixel + i];
      for (int i = 0; i < count && job.first && job.grad_alpha; i++) block.extra[lane + i] = job.grad_alpha[pixel + i];
    }
}

}  // namespace FS_NS
