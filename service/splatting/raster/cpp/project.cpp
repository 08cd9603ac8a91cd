// Once per Gaussian: cull, project, find the tiles. Doubles throughout; see reference.py for the plain formulas.
#include "kernels.h"
#include "projection.h"

namespace FS_NS {
using namespace fs;

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
  for (int64_t start = begin; start < end; start += DW) {
    const int lanes = end - start < DW ? (int)(end - start) : DW;
    bool good[DW];
    bool some = false;
    for (int l = 0; l < lanes; l++) {
      const int64_t g = start + l;
      radii[g] = 0;
      const float *m = in.means + g * 3, *q = in.quats + g * 4;
      good[l] = clean || (finite_row(m, 3) && finite_row(q, 4) && finite_row(in.scales + g * 3, 3) &&
                          finite_row(in.opacities + g, 1) && finite_row(in.features + g * channels, channels));
      broken += !good[l];
      good[l] = good[l] && (q[0] != 0 || q[1] != 0 || q[2] != 0 || q[3] != 0) &&
                in.opacities[g] >= (float)view.alpha_min;
      const double* r = view.rotation + 6;
      const double z = r[0] * m[0] + r[1] * m[1] + r[2] * m[2] + view.translation[2];
      good[l] = good[l] && z > view.near_z && z < view.far_z;
      some |= good[l];
    }
    if (!some) continue;
    Geometry s;
    load_geometry(in, start, good, lanes, s);
    project_geometry(view, s);
    vd opacity = set1d(1.0);
    for (int l = 0; l < lanes; l++)
      if (good[l]) opacity[l] = in.opacities[start + l];
    for (int l = 0; l < lanes; l++) {
      if (!good[l]) continue;
      const double log_opacity = std::log2(opacity[l]);
      const double reach = 2.0 * 0.6931471805599453 * (log_opacity - log_min);
      const double va = s.a[l], vb = s.b[l], vc = s.c[l], det = s.det[l], x = s.u[l], y = s.v[l];
      const double largest = 0.5 * (va + vc) + std::sqrt(0.25 * (va - vc) * (va - vc) + vb * vb);
      const double radius = std::ceil(std::sqrt(reach > 0 ? reach * largest : 0.0));
      if (!(radius < HUGE_VAL) || !(std::fabs(x) < HUGE_VAL) || !(std::fabs(y) < HUGE_VAL)) continue;
      if (!(det > 0) || !(det < HUGE_VAL)) continue;
      const double hx = std::sqrt(reach > 0 ? reach * va : 0.0), hy = std::sqrt(reach > 0 ? reach * vc : 0.0);
      const double x0 = std::ceil(x - hx - 0.5), x1 = std::floor(x + hx - 0.5);
      const double y0 = std::ceil(y - hy - 0.5), y1 = std::floor(y + hy - 0.5);
      if ((x0 > 0 ? x0 : 0) > (x1 < view.width - 1 ? x1 : view.width - 1)) continue;
      if ((y0 > 0 ? y0 : 0) > (y1 < view.height - 1 ? y1 : view.height - 1)) continue;
      radii[start + l] = radius < 1 ? 1 : radius > 1073741824.0 ? 1073741824 : (int32_t)radius;
      Projected& p = out[visible++];
      p.x = x;
      p.y = y;
      const double k = WHITEN, root = 1.0 / std::sqrt(vc * det);
      p.a = (float)(k * vc * root);
      p.b = (float)(-k * vb * root);
      p.c = (float)(k / std::sqrt(vc));
      p.log_opacity = (float)log_opacity;
      p.depth = (float)s.z[l];
      p.id = (int32_t)(start + l);
    }
  }
  *bad = broken;
  return visible;
}

// Exact spans of the ellipse alpha >= alpha_min: for each strip of BLOCK_H pixel rows its leftmost and rightmost point.
bool spans(const View& view, const Projected& p, Pairs& pairs) {
  constexpr int STRIPS = TILE / BLOCK_H, COLUMNS = TILE / 4;
  const double a = p.a, b = p.b, c = p.c;
  const double reach = p.log_opacity - (double)std::log2((float)view.alpha_min);
  const double radius2 = reach > 0 ? reach : 0, radius = std::sqrt(radius2);
  const double half = radius / c, inverse = 1.0 / a, margin = 1e-3;
  const double slope = b / c;
  const double tip = -radius * slope / std::sqrt(1.0 + slope * slope) / c;  // dy of the rightmost point
  const double top = p.y - half - 0.5 - margin, bottom = p.y + half - 0.5 + margin;
  const int y0 = top > 0 ? (int)top : 0;
  const int y1 = bottom < view.height - 1 ? (int)std::floor(bottom) : view.height - 1;
  if (y0 > y1) return true;
  const int tiles_x = (view.width + TILE - 1) / TILE;
  for (int row = y0 / TILE; row <= y1 / TILE; row++) {
    int left[STRIPS], right[STRIPS], lowest = INT32_MAX, highest = -1;
    for (int s = 0; s < STRIPS; s++) {
      left[s] = 1;
      right[s] = 0;
      const int y = row * TILE + s * BLOCK_H;
      double from = y + 0.5 - p.y, to = from + (BLOCK_H - 1);
      from = from < -half ? -half : from;
      to = to > half ? half : to;
      if (from > to + margin) continue;
      double d = tip < from ? from : tip > to ? to : tip;
      double rest = radius2 - c * c * d * d;
      double x1 = p.x - 0.5 + ((rest > 0 ? std::sqrt(rest) : 0.0) - b * d) * inverse + margin;
      d = -tip < from ? from : -tip > to ? to : -tip;
      rest = radius2 - c * c * d * d;
      double x0 = p.x - 0.5 - ((rest > 0 ? std::sqrt(rest) : 0.0) + b * d) * inverse - margin;
      x0 = x0 > 0 ? std::ceil(x0) : 0;
      x1 = x1 < view.width - 1 ? std::floor(x1) : view.width - 1;
      if (!(x0 <= x1)) continue;
      left[s] = (int)x0 / 4;
      right[s] = (int)x1 / 4;
      lowest = left[s] < lowest ? left[s] : lowest;
      highest = right[s] > highest ? right[s] : highest;
    }
    if (highest < 0) continue;
    for (int tile = lowest / COLUMNS; tile <= highest / COLUMNS; tile++) {
      uint64_t blocks = 0;
      for (int s = 0; s < STRIPS; s++) {
        int from = left[s] - tile * COLUMNS, to = right[s] - tile * COLUMNS;
        from = from < 0 ? 0 : from;
        to = to > COLUMNS - 1 ? COLUMNS - 1 : to;
        if (left[s] <= right[s] && from <= to)
          blocks |= (((1ull << (to - from + 1)) - 1) << from) << (s * COLUMNS);
      }
      if (!blocks) continue;
      if (pairs.count == pairs.capacity) return false;
      pairs.tile[pairs.count] = row * tiles_x + tile;
      pairs.blocks[pairs.count++] = blocks;
    }
  }
  return true;
}

}  // namespace FS_NS
