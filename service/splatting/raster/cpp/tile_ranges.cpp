// Which tiles a projected Gaussian reaches.
#include "kernels.h"
#include "projection.h"

namespace FS_NS {
using namespace fs;

constexpr int COLUMNS = TILE_W / 4;  // blocks across a tile

// The tiles, and blocks in them, that the ellipse alpha >= alpha_min touches. Exact: for each strip of BLOCK_H pixel
// rows its leftmost and rightmost point, DW strips at a time.
bool tile_ranges(const View& view, const Projected& p, IsectList& isects) {
  typedef int32_t vh __attribute__((vector_size(DW * 4)));
  typedef uint64_t vu __attribute__((vector_size(DW * 8)));
  constexpr int STRIPS = TILE_H / BLOCK_H, BATCH = STRIPS > DW ? STRIPS : DW, WIDE = 64 / COLUMNS;
  const double b = p.b, c = p.c, margin = 1e-3, half = p.half_height, tip = p.tip, inverse = 1.0 / (double)p.a;
  const double reach = (double)p.log_opacity - (double)isects.log_alpha_min, radius2 = reach > 0 ? reach : 0;
  const auto inside = [](double x, double limit) { return x > 0 ? (x < limit ? (int)x : (int)limit) : 0; };
  const double left = p.x - p.half_width - 0.5 - margin, right = p.x + p.half_width - 0.5 + margin;
  const double top = p.y - half - 0.5 - margin, bottom = p.y + half - 0.5 + margin;
  if (right < 0 || bottom < 0 || left >= view.width || top >= view.height) return true;
  const int first_row = inside(top, view.height - 1) / TILE_H, last_row = inside(bottom, view.height - 1) / TILE_H;
  const int first_tile = inside(left, view.width - 1) / TILE_W, last_tile = inside(right, view.width - 1) / TILE_W;
  const int tiles_x = (view.width + TILE_W - 1) / TILE_W;
  vd steps;
  for (int l = 0; l < DW; l++) steps[l] = l * BLOCK_H;
  const vd end = set1d(view.width), floor_x = set1d(p.x - 0.5), cc = set1d(c * c);
  for (int row = first_row; row <= last_row; row += BATCH / STRIPS) {
    vh from[BATCH / DW], to[BATCH / DW];  // blocks from the left edge of the image; to < from: none
    for (int s = 0; s < BATCH / DW; s++) {
      const vd start = (row * TILE_H + s * DW * BLOCK_H + 0.5 - p.y) + steps;
      const vd high = vmax(start, set1d(-half)), low = vmin(start + (BLOCK_H - 1), set1d(half));
      const vd d1 = vmin(vmax(set1d(tip), high), low), d0 = vmin(vmax(set1d(-tip), high), low);
      const vd x1 = floor_x + (vsqrt(vmax(radius2 - cc * d1 * d1, vd{})) - b * d1) * inverse + margin;
      const vd x0 = floor_x - (vsqrt(vmax(radius2 - cc * d0 * d0, vd{})) + b * d0) * inverse - margin;
      // First and last pixel in reach: x0 rounded up, x1 rounded down; conversion rounds to 0.
      const vh first = __builtin_convertvector(vmin(vmax(x0 + 0.999999999, vd{}), end), vh);
      const vh last = __builtin_convertvector(vmin(vmax(x1 + 1.0, vd{}), end), vh) - 1;
      const vh some = (first <= last) & __builtin_convertvector(high <= low + margin, vh);
      from[s] = first >> 2;
      to[s] = some ? last >> 2 : vh{} - 1;
    }
    const int rows = last_row - row + 1 < BATCH / STRIPS ? last_row - row + 1 : BATCH / STRIPS;
    for (int begin = first_tile; begin <= last_tile; begin += WIDE) {
      const int tiles = last_tile - begin < WIDE ? last_tile - begin + 1 : WIDE;
      if (isects.count + rows * tiles > isects.capacity) return false;
      // The blocks of each strip as bits of one word, then a tile's share of every word.
      alignas(64) uint64_t strip[BATCH];
      for (int s = 0; s < BATCH / DW; s++) {
        const vh low = from[s] - begin * COLUMNS, high = to[s] - begin * COLUMNS;
        const vh start = low > 0 ? low : vh{}, stop = high < 63 ? high : vh{} + 63, some = start <= stop;
        const vu words = (~vu{} >> __builtin_convertvector((63 - (stop - start)) & 63, vu))
                         << __builtin_convertvector(start & 63, vu);
        *(vu*)(strip + s * DW) = words & (vu) __builtin_convertvector(some, vl);
      }
      for (int r = 0; r < rows; r++)
        for (int tile = 0; tile < tiles; tile++) {
          uint64_t blocks = 0;
          for (int s = 0; s < STRIPS; s++)
            blocks |= (strip[r * STRIPS + s] >> (tile * COLUMNS) & ((1 << COLUMNS) - 1)) << (s * COLUMNS);
          isects.tile[isects.count] = (row + r) * tiles_x + begin + tile;
          isects.blocks[isects.count] = blocks;
          isects.count += blocks != 0;
        }
    }
  }
  return true;
}

}  // namespace FS_NS
