// Once per Gaussian, backward: adds up the sums of its intersections, then the chain rule from the whitened moments to
// the inputs. With conic = L Lᵀ, w = Lᵀ(p − mean) and g = dLoss/dα·α per pixel: dLoss/dmean = L Σ g w and dLoss/dΣ = ½
// L (Σ g w wᵀ) Lᵀ, so no difference of large numbers appears, however thin the ellipse.
#include "kernels.h"
#include "projection.h"

namespace FS_NS {
using namespace fs;

// Column by column over the intersections of one Gaussian: moments and depth into total, features into their row of the
// output.
static inline void add_sums(const ProjectionBackwardJob& job, uint32_t rank, float* total, float* features) {
  const int64_t begin = job.slot_start[rank], end = job.slot_start[rank + 1], stride = job.sum_stride;
  const int64_t width = MOMENTS + 1 + job.in.channels;
  for (int64_t at = 0; at < width; at += W) {
    vf acc = zero();
    for (int64_t s = begin; s < end; s++) acc = acc + load(job.sums + s * stride + at);
    float column[W];
    storeu(column, acc);
    for (int64_t i = 0; i < W && at + i < width; i++)
      (at + i <= MOMENTS ? total[at + i] : features[at + i - MOMENTS - 1]) = column[i];
  }
}

static inline float bounded(double x) {
  const double limit = 3.0e38;
  return (float)(x > limit ? limit : x < -limit ? -limit : x);
}

// vd in, vd out: gradients of mean, quat, scale from m = moments [6], dz; and, if d_pose, of camera-from-world:
// rotation [9], translation [3].
static inline void chain(const View& view, const Geometry& s, const vd* m, vd grad_depth, vd* d_mean, vd* d_quat,
                         vd* d_scale, vd* d_pose) {
  const double k2 = WHITEN * WHITEN;
  const vd root = 1.0 / vsqrt(s.c * s.det);
  const vd l11 = WHITEN * s.c * root, l21 = -WHITEN * s.b * root, l22 = WHITEN / vsqrt(s.c);
  const vd du = l11 * m[1] / k2, dv = (l21 * m[1] + l22 * m[2]) / k2;
  // V = ½ L M Lᵀ, symmetric, with M = [[m3, m4], [m4, m5]].
  const double half = 0.5 / (k2 * k2);
  const vd t0 = l21 * m[3] + l22 * m[4], t1 = l21 * m[4] + l22 * m[5];
  const vd v00 = half * l11 * l11 * m[3], v01 = half * l11 * t0, v11 = half * (l21 * t0 + l22 * t1);
  // dF = 2 V F.
  vd df[6], db[9];
  for (int j = 0; j < 3; j++) {
    df[j] = 2 * (v00 * s.factor[j] + v01 * s.factor[3 + j]);
    df[3 + j] = 2 * (v01 * s.factor[j] + v11 * s.factor[3 + j]);
  }
  vd dj00 = vd{}, dj02 = vd{}, dj11 = vd{}, dj12 = vd{};
  for (int j = 0; j < 3; j++) {
    const vd row0 = s.basis[j], row1 = s.basis[3 + j], row2 = s.basis[6 + j];
    const vd f0 = df[j] * s.scale[j], f1 = df[3 + j] * s.scale[j];
    dj00 += f0 * row0;
    dj02 += f0 * row2;
    dj11 += f1 * row1;
    dj12 += f1 * row2;
    d_scale[j] = df[j] * (s.j00 * row0 + s.j02 * row2) + df[3 + j] * (s.j11 * row1 + s.j12 * row2);
    db[j] = s.j00 * f0;
    db[3 + j] = s.j11 * f1;
    db[6 + j] = s.j02 * f0 + s.j12 * f1;
  }
  const double* r = view.rotation;
  vd da[9];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) da[i * 3 + j] = r[i] * db[j] + r[3 + i] * db[3 + j] + r[6 + i] * db[6 + j];
  const vd w = s.quat[0], x = s.quat[1], y = s.quat[2], z = s.quat[3];
  vd dq[4];
  dq[0] = 2 * (x * (da[7] - da[5]) + y * (da[2] - da[6]) + z * (da[3] - da[1]));
  dq[1] = 2 * (-2 * x * (da[4] + da[8]) + y * (da[1] + da[3]) + z * (da[2] + da[6]) + w * (da[7] - da[5]));
  dq[2] = 2 * (x * (da[1] + da[3]) - 2 * y * (da[0] + da[8]) + z * (da[5] + da[7]) + w * (da[2] - da[6]));
  dq[3] = 2 * (x * (da[2] + da[6]) + y * (da[5] + da[7]) - 2 * z * (da[0] + da[4]) + w * (da[3] - da[1]));
  const vd along = w * dq[0] + x * dq[1] + y * dq[2] + z * dq[3];
  for (int i = 0; i < 4; i++) d_quat[i] = (dq[i] - s.quat[i] * along) / (s.length * s.unit);

  const vd rz = 1.0 / s.z;
  const vd none = vd{};
  const vd dray_x = s.free_x ? -view.fx * rz * dj02 : none, dray_y = s.free_y ? -view.fy * rz * dj12 : none;
  const vd dtx = view.fx * du + dray_x, dty = view.fy * dv + dray_y;  // x/z and y/z
  const vd dx = dtx * rz, dy = dty * rz;
  const vd dz =
      grad_depth - (dtx * s.x + dty * s.y) * rz * rz - rz * (s.j00 * dj00 + s.j02 * dj02 + s.j11 * dj11 + s.j12 * dj12);
  for (int i = 0; i < 3; i++) d_mean[i] = r[i] * dx + r[3 + i] * dy + r[6 + i] * dz;
  if (!d_pose) return;
  const vd point[3] = {dx, dy, dz};
  for (int i = 0; i < 3; i++) {
    d_pose[9 + i] = point[i];
    for (int j = 0; j < 3; j++)
      d_pose[i * 3 + j] = point[i] * s.mean[j] + db[i * 3] * s.axes[j * 3] + db[i * 3 + 1] * s.axes[j * 3 + 1] +
                          db[i * 3 + 2] * s.axes[j * 3 + 2];
  }
}

void projection_backward(const ProjectionBackwardJob& job, int64_t begin, int64_t end, int64_t physical,
                         int64_t visible) {
  const int32_t channels = job.in.channels;
  std::memset(job.out.means + begin * 3, 0, (end - begin) * 3 * sizeof(float));
  std::memset(job.out.quats + begin * 4, 0, (end - begin) * 4 * sizeof(float));
  std::memset(job.out.scales + begin * 3, 0, (end - begin) * 3 * sizeof(float));
  std::memset(job.out.opacities + begin, 0, (end - begin) * sizeof(float));
  std::memset(job.out.features + begin * channels, 0, (end - begin) * channels * sizeof(float));
  float total[DW][MOMENTS + 1];
  for (int64_t start = 0; start < visible; start += DW) {
    const int lanes = visible - start < DW ? (int)(visible - start) : DW;
    for (int64_t l = start + DW; l < start + 2 * DW && l < visible; l++) {
      const uint32_t rank = job.rank_of[physical + l];
      const int64_t last = job.slot_start[rank + 1] * job.sum_stride;
      int64_t at = job.slot_start[rank] * job.sum_stride;
      for (int lines = 0; at < last && lines < 8; at += 16, lines++) __builtin_prefetch(job.sums + at);
    }
    int32_t ids[DW];
    for (int l = 0; l < lanes; l++) ids[l] = job.projected[physical + start + l].id;
    Geometry s;
    load_geometry(job.in, ids, lanes, s);
    vd m[MOMENTS], depth = vd{};
    for (vd& x : m) x = vd{};
    for (int l = 0; l < lanes; l++) {
      add_sums(job, job.rank_of[physical + start + l], total[l], job.out.features + (int64_t)ids[l] * channels);
      for (int i = 0; i < MOMENTS; i++) m[i][l] = total[l][i];
      depth[l] = total[l][MOMENTS];
    }
    project_geometry(job.view, s);
    vd d_mean[3], d_quat[4], d_scale[3], d_pose[12];
    chain(job.view, s, m, depth, d_mean, d_quat, d_scale, job.pose ? d_pose : nullptr);
    for (int l = 0; l < lanes; l++) {
      const int64_t g = ids[l];
      for (int i = 0; i < 3; i++) job.out.means[g * 3 + i] = bounded(d_mean[i][l]);
      for (int i = 0; i < 4; i++) job.out.quats[g * 4 + i] = bounded(d_quat[i][l]);
      for (int i = 0; i < 3; i++) job.out.scales[g * 3 + i] = bounded(d_scale[i][l]);
      job.out.opacities[g] = bounded(m[0][l] / (double)job.in.opacities[g]);
      for (int i = 0; i < 12 && job.pose; i++) job.pose[i] += d_pose[i][l];
    }
  }
}

}  // namespace FS_NS
