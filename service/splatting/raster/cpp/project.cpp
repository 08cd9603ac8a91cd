// Once per Gaussian: cull, project, find the tiles. Doubles throughout; see reference.py for the plain formulas.
#include "kernels.h"
#include "projection.h"

namespace FS_NS {
using namespace fs;

constexpr int MAX_CHUNK = 4096;  // rows a call
constexpr int COLUMNS = TILE_W / 4;  // blocks across a tile

static bool finite_row(const float* p, int64_t n) {
  uint32_t bad = 0;
  for (int64_t i = 0; i < n; i++) {
    uint32_t bits;
    std::memcpy(&bits, p + i, 4);
    bad |= (bits & 0x7f800000u) == 0x7f800000u;
  }
  return !bad;
}

int64_t project(const View& view, const Inputs& in, int64_t begin, int64_t end, Projected* out, int32_t* radii,
                int64_t* bad) {
  const int64_t channels = in.channels;
  // One look at the whole range; rows are looked at one by one only if something is wrong somewhere.
  const int64_t n = end - begin;
  const bool clean = finite_row(in.means + begin * 3, n * 3) && finite_row(in.quats + begin * 4, n * 4) &&
                     finite_row(in.scales + begin * 3, n * 3) && finite_row(in.opacities + begin, n) &&
                     finite_row(in.features + begin * channels, n * channels);
  int64_t visible = 0, broken = 0;
  const double log_min = std::log2((float)view.alpha_min);
  int32_t candidates[MAX_CHUNK];
  int count = 0;
  for (int64_t g = begin; g < end; g++) {
    radii[g] = 0;
    const float *m = in.means + g * 3, *q = in.quats + g * 4;
    if (!clean && !(finite_row(m, 3) && finite_row(q, 4) && finite_row(in.scales + g * 3, 3) &&
                    finite_row(in.opacities + g, 1) && finite_row(in.features + g * channels, channels))) {
      broken++;
      continue;
    }
    const double* r = view.rotation + 6;
    const double z = r[0] * m[0] + r[1] * m[1] + r[2] * m[2] + view.translation[2];
    const bool turned = q[0] != 0 || q[1] != 0 || q[2] != 0 || q[3] != 0;
    candidates[count] = (int32_t)g;
    count += turned & (in.opacities[g] >= (float)view.alpha_min) & (z > view.near_z) & (z < view.far_z);
  }
  for (int start = 0; start < count; start += DW) {
    const int lanes = count - start < DW ? count - start : DW;
    Geometry s;
    load_geometry(in, candidates + start, lanes, s);
    project_geometry(view, s);
    vd reach = vd{}, log_opacity = vd{};
    for (int l = 0; l < lanes; l++) {
      log_opacity[l] = std::log2(in.opacities[candidates[start + l]]);
      reach[l] = 2.0 * 0.6931471805599453 * (log_opacity[l] - log_min);
    }
    reach = vmax(reach, vd{});
    const vd gap = 0.5 * (s.a - s.c);
    const vd radius = vsqrt(reach * (0.5 * (s.a + s.c) + vsqrt(gap * gap + s.b * s.b)));
    const vd hx = vsqrt(reach * s.a), hy = vsqrt(reach * s.c);
    const vd root = WHITEN / vsqrt(s.c * s.det), wa = s.c * root, wb = -s.b * root, wc = WHITEN / vsqrt(s.c);
    // In whitened units the ellipse alpha >= alpha_min is a circle. From the floats that the tiles will compute with.
    vd radius2 = vd{}, slope = vd{}, tall = set1d(1.0);
    for (int l = 0; l < lanes; l++) {
      radius2[l] = log_opacity[l] - log_min;
      slope[l] = (float)wb[l];
      tall[l] = (float)wc[l];
    }
    slope /= tall;
    const vd half_height = vsqrt(vmax(radius2, vd{})) / tall, tip = -half_height * slope / vsqrt(1.0 + slope * slope);
    for (int l = 0; l < lanes; l++) {
      const double x = s.u[l], y = s.v[l];
      if (!(radius[l] < HUGE_VAL) || !(std::fabs(x) < HUGE_VAL) || !(std::fabs(y) < HUGE_VAL)) continue;
      if (!(s.det[l] > 0) || !(s.det[l] < HUGE_VAL)) continue;
      const double x0 = std::ceil(x - hx[l] - 0.5), x1 = std::floor(x + hx[l] - 0.5);
      const double y0 = std::ceil(y - hy[l] - 0.5), y1 = std::floor(y + hy[l] - 0.5);
      if ((x0 > 0 ? x0 : 0) > (x1 < view.width - 1 ? x1 : view.width - 1)) continue;
      if ((y0 > 0 ? y0 : 0) > (y1 < view.height - 1 ? y1 : view.height - 1)) continue;
      const int32_t g = candidates[start + l];
      const double whole = std::ceil(radius[l]);
      radii[g] = whole < 1 ? 1 : whole > 1073741824.0 ? 1073741824 : (int32_t)whole;
      Projected& p = out[visible++];
      p.x = x;
      p.y = y;
      p.a = (float)wa[l];
      p.b = (float)wb[l];
      p.c = (float)wc[l];
      p.log_opacity = (float)log_opacity[l];
      p.depth = (float)s.z[l];
      p.id = g;
      p.half_width = (float)(hx[l] * 1.000001);
      p.half_height = (float)(half_height[l] * 1.000001);
      p.tip = (float)tip[l];
    }
  }
  *bad = broken;
  return visible;
}

// Exact spans of the ellipse alpha >= alpha_min: for each strip of BLOCK_H pixel rows its leftmost and rightmost point,
// DW strips at a time.
bool spans(const View& view, const Projected& p, Pairs& pairs) {
  typedef int32_t vh __attribute__((vector_size(DW * 4)));
  typedef uint64_t vu __attribute__((vector_size(DW * 8)));
  constexpr int STRIPS = TILE_H / BLOCK_H, BATCH = STRIPS > DW ? STRIPS : DW, WIDE = 64 / COLUMNS;
  const double b = p.b, c = p.c, margin = 1e-3, half = p.half_height, tip = p.tip, inverse = 1.0 / (double)p.a;
  const double reach = (double)p.log_opacity - (double)pairs.log_alpha_min, radius2 = reach > 0 ? reach : 0;
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
      if (pairs.count + rows * tiles > pairs.capacity) return false;
      // The blocks of each strip as bits of one word, then a tile's share of every word.
      alignas(64) uint64_t strip[BATCH];
      for (int s = 0; s < BATCH / DW; s++) {
        const vh low = from[s] - begin * COLUMNS, high = to[s] - begin * COLUMNS;
        const vh start = low > 0 ? low : vh{}, stop = high < 63 ? high : vh{} + 63, some = start <= stop;
        const vu words = (~vu{} >> __builtin_convertvector((63 - (stop - start)) & 63, vu)) << __builtin_convertvector(start & 63, vu);
        *(vu*)(strip + s * DW) = words & (vu)__builtin_convertvector(some, vl);
      }
      for (int r = 0; r < rows; r++)
        for (int tile = 0; tile < tiles; tile++) {
          uint64_t blocks = 0;
          for (int s = 0; s < STRIPS; s++)
            blocks |= (strip[r * STRIPS + s] >> (tile * COLUMNS) & ((1 << COLUMNS) - 1)) << (s * COLUMNS);
          pairs.tile[pairs.count] = (row + r) * tiles_x + begin + tile;
          pairs.blocks[pairs.count] = blocks;
          pairs.count += blocks != 0;
        }
    }
  }
  return true;
}

}  // namespace FS_NS
