// Once per Gaussian: cull and project. Doubles throughout; see reference.py for the plain formulas.
#include "kernels.h"
#include "projection.h"

namespace FS_NS {
using namespace fs;

constexpr int MAX_CHUNK = 4096;  // rows a call

static bool finite_row(const float* p, int64_t n) {
  uint32_t special = 0;
  for (int64_t i = 0; i < n; i++) {
    uint32_t bits;
    std::memcpy(&bits, p + i, 4);
    special |= (bits & 0x7f800000u) == 0x7f800000u;
  }
  return !special;
}

int64_t project(const View& view, const Inputs& in, int64_t begin, int64_t end, Projected* out, int32_t* radii,
                int64_t* non_finite) {
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
  *non_finite = broken;
  return visible;
}

}  // namespace FS_NS
