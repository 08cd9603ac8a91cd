// The geometry of DW Gaussians at once, in doubles, kept for the backward pass. Formulas: "Mathematical supplement for
// the gsplat library" (Ye & Kanazawa 2023), sections 2 and 3; the determinant by Cauchy-Binet as in reference.py.
#pragma once
#include "kernels.h"
#include "simd.h"

namespace FS_NS {

constexpr double WHITEN = 0.8493218002880191;  // sqrt(log2(e) / 2): exponents are powers of two, see Projected

struct Geometry {
  vd mean[3], quat[4], length, scale[3];  // quat: unit length; length: of the input, in units of `unit`
  vd unit;                                // largest |component| of the input quaternion
  vd x, y, z, ray_x, ray_y;               // camera frame; clamped x/z and y/z of the Jacobian
  vl free_x, free_y;                      // lanes where the clamp does not act
  vd axes[9], basis[9];                   // world-from-Gaussian rotation; camera-from-Gaussian rotation
  vd j00, j02, j11, j12;
  vd factor[6];           // J · basis · diag(scale)
  vd a, b, c, det, u, v;  // 2D covariance with eps2d, its determinant, the mean in pixels
};

// Rows ids[0..lanes); spare lanes repeat the first.
FS_INLINE void load_geometry(const fs::Inputs& in, const int32_t* ids, int lanes, Geometry& s) {
  for (int l = 0; l < DW; l++) {
    const int64_t g = ids[l < lanes ? l : 0];
    for (int i = 0; i < 3; i++) s.mean[i][l] = in.means[g * 3 + i];
    for (int i = 0; i < 3; i++) s.scale[i][l] = in.scales[g * 3 + i];
    for (int i = 0; i < 4; i++) s.quat[i][l] = in.quats[g * 4 + i];
  }
}

FS_INLINE void project_geometry(const fs::View& view, Geometry& s) {
  const double *r = view.rotation, *t = view.translation;
  s.unit = vmax(vmax(vabs(s.quat[0]), vabs(s.quat[1])), vmax(vabs(s.quat[2]), vabs(s.quat[3])));
  for (vd& q : s.quat) q /= s.unit;
  s.length = vsqrt(s.quat[0] * s.quat[0] + s.quat[1] * s.quat[1] + s.quat[2] * s.quat[2] + s.quat[3] * s.quat[3]);
  for (vd& q : s.quat) q /= s.length;
  const vd qw = s.quat[0], qx = s.quat[1], qy = s.quat[2], qz = s.quat[3];
  s.axes[0] = 1 - 2 * (qy * qy + qz * qz);
  s.axes[1] = 2 * (qx * qy - qw * qz);
  s.axes[2] = 2 * (qx * qz + qw * qy);
  s.axes[3] = 2 * (qx * qy + qw * qz);
  s.axes[4] = 1 - 2 * (qx * qx + qz * qz);
  s.axes[5] = 2 * (qy * qz - qw * qx);
  s.axes[6] = 2 * (qx * qz - qw * qy);
  s.axes[7] = 2 * (qy * qz + qw * qx);
  s.axes[8] = 1 - 2 * (qx * qx + qy * qy);
  s.x = r[0] * s.mean[0] + r[1] * s.mean[1] + r[2] * s.mean[2] + t[0];
  s.y = r[3] * s.mean[0] + r[4] * s.mean[1] + r[5] * s.mean[2] + t[1];
  s.z = r[6] * s.mean[0] + r[7] * s.mean[1] + r[8] * s.mean[2] + t[2];
  const vd rz = 1.0 / s.z;
  const double margin_x = 0.15 * view.width / view.fx, margin_y = 0.15 * view.height / view.fy;
  const double low_x = -view.cx / view.fx - margin_x, high_x = (view.width - view.cx) / view.fx + margin_x;
  const double low_y = -view.cy / view.fy - margin_y, high_y = (view.height - view.cy) / view.fy + margin_y;
  const vd tx = s.x * rz, ty = s.y * rz;
  s.ray_x = vmin(vmax(tx, set1d(low_x)), set1d(high_x));
  s.ray_y = vmin(vmax(ty, set1d(low_y)), set1d(high_y));
  s.free_x = (tx >= low_x) & (tx <= high_x);
  s.free_y = (ty >= low_y) & (ty <= high_y);
  s.u = view.fx * tx + view.cx;
  s.v = view.fy * ty + view.cy;
  s.j00 = view.fx * rz;
  s.j02 = -view.fx * s.ray_x * rz;
  s.j11 = view.fy * rz;
  s.j12 = -view.fy * s.ray_y * rz;
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      s.basis[i * 3 + j] = r[i * 3] * s.axes[j] + r[i * 3 + 1] * s.axes[3 + j] + r[i * 3 + 2] * s.axes[6 + j];
  vd* f = s.factor;
  for (int j = 0; j < 3; j++) {
    f[j] = (s.j00 * s.basis[j] + s.j02 * s.basis[6 + j]) * s.scale[j];
    f[3 + j] = (s.j11 * s.basis[3 + j] + s.j12 * s.basis[6 + j]) * s.scale[j];
  }
  const double eps = view.eps2d;
  const vd a = f[0] * f[0] + f[1] * f[1] + f[2] * f[2], c = f[3] * f[3] + f[4] * f[4] + f[5] * f[5];
  const vd p = f[1] * f[5] - f[2] * f[4], q = f[2] * f[3] - f[0] * f[5], w = f[0] * f[4] - f[1] * f[3];
  s.b = f[0] * f[3] + f[1] * f[4] + f[2] * f[5];
  s.det = p * p + q * q + w * w + eps * (a + c) + eps * eps;
  s.a = a + eps;
  s.c = c + eps;
}

}  // namespace FS_NS
