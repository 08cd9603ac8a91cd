// For the benchmark: how much work a view holds, and how fast this machine could do it.
#include "kernels.h"
#include "simd.h"

namespace FS_NS {
using namespace fs;

// Counted: alpha at or above the limit, pixel not finished.
static int64_t count_contributing(const TileJob& job, int32_t tile) {
  const int64_t begin = job.tile_start[tile];
  const double left = (tile % job.tiles_x) * TILE_W + 0.5, top = (tile / job.tiles_x) * TILE_H + 0.5;
  int64_t useful = 0;
  for (int64_t i = 0; i < job.tile_used[tile]; i++) {
    const float* record = job.records + (int64_t)job.isects[begin + i].rank * job.stride;
    double center[2];
    std::memcpy(center, record, sizeof center);
    for (uint64_t bits = job.isects[begin + i].blocks; bits; bits &= bits - 1) {
      const int block = __builtin_ctzll(bits);
      for (int l = 0; l < W; l++) {
        const double dx = left + (block % (TILE_W / 4)) * 4 + l % 4 - center[0];
        const double dy = top + (block / (TILE_W / 4)) * BLOCK_H + l / 4 - center[1];
        const double u = record[4] * dx + record[5] * dy, v = record[6] * dy;
        useful += record[7] - u * u - v * v >= job.log_alpha_min &&
                  job.stop[(int64_t)tile * TILE_W * TILE_H + block * W + l] > i;
      }
    }
  }
  return useful;
}

static int64_t peak_fma(int64_t rounds, float* sink) {
  vf x[12];
  for (int i = 0; i < 12; i++) x[i] = set1(1.0f + (float)i);
  const vf a = set1(0.999f), b = set1(1e-3f);
  for (int64_t r = 0; r < rounds; r++)
    for (int i = 0; i < 12; i++) x[i] = fma(x[i], a, b);
  for (int i = 0; i < 12; i++) *sink += sum(x[i]);
  return rounds * 12;
}

extern const BenchKernels bench_kernels = {count_contributing, peak_fma};

}  // namespace FS_NS
