// Real spherical harmonics up to degree 3, 3DGS signs; see harmonics.py for the plain twin and the constants' source.
#include "kernels.h"
#include "simd.h"

namespace FS_NS {
using namespace fs;

constexpr float C0 = 0.28209479177387814f, C1 = 0.4886025119029199f;
constexpr float C2A = 1.0925484305920792f, C2B = 0.31539156525252005f, C2C = 0.5462742152960396f;
constexpr float C3A = 0.5900435899266435f, C3B = 2.890611442640554f, C3C = 0.4570457994644658f;
constexpr float C3D = 0.3731763325901154f, C3E = 1.445305721320277f;

struct Direction {
  float x, y, z, inverse;  // unit, and 1 / length; all 0 for a zero offset
};

FS_INLINE Direction direction_of(const SphericalHarmonicsJob& job, int64_t g) {
  // In doubles: a length of 1e-30 or 1e30 squared stays in range.
  const double x = (double)job.means[g * 3] - job.camera[0], y = (double)job.means[g * 3 + 1] - job.camera[1],
               z = (double)job.means[g * 3 + 2] - job.camera[2];
  const double length = std::sqrt(x * x + y * y + z * z);
  const double inverse = length == 0 ? 0.0 : 1.0 / (length < 1e-20 ? 1e-20 : length);
  return {(float)(x * inverse), (float)(y * inverse), (float)(z * inverse), (float)inverse};
}

template <int DEGREE>
FS_INLINE void basis(const Direction& d, float* out) {
  const float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  out[0] = C0;
  if (DEGREE >= 1) {
    out[1] = -C1 * y;
    out[2] = C1 * z;
    out[3] = -C1 * x;
  }
  if (DEGREE >= 2) {
    out[4] = C2A * x * y;
    out[5] = -C2A * y * z;
    out[6] = C2B * (2 * zz - xx - yy);
    out[7] = -C2A * x * z;
    out[8] = C2C * (xx - yy);
  }
  if (DEGREE >= 3) {
    out[9] = -C3A * y * (3 * xx - yy);
    out[10] = C3B * x * y * z;
    out[11] = -C3C * y * (4 * zz - xx - yy);
    out[12] = C3D * z * (2 * zz - 3 * xx - 3 * yy);
    out[13] = -C3C * x * (4 * zz - xx - yy);
    out[14] = C3E * z * (xx - yy);
    out[15] = -C3A * x * (xx - 3 * yy);
  }
}

// d += Σ_k w[k] ∇Y_k.
template <int DEGREE>
FS_INLINE void basis_gradient(const Direction& d, const float* w, float* g) {
  const float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  if (DEGREE >= 1) {
    g[0] -= C1 * w[3];
    g[1] -= C1 * w[1];
    g[2] += C1 * w[2];
  }
  if (DEGREE >= 2) {
    g[0] += C2A * (y * w[4] - z * w[7]) - 2 * C2B * x * w[6] + 2 * C2C * x * w[8];
    g[1] += C2A * (x * w[4] - z * w[5]) - 2 * C2B * y * w[6] - 2 * C2C * y * w[8];
    g[2] += -C2A * (y * w[5] + x * w[7]) + 4 * C2B * z * w[6];
  }
  if (DEGREE >= 3) {
    g[0] += -6 * C3A * x * y * w[9] + C3B * y * z * w[10] + 2 * C3C * x * y * w[11] - 6 * C3D * x * z * w[12] -
            C3C * (4 * zz - 3 * xx - yy) * w[13] + 2 * C3E * x * z * w[14] - 3 * C3A * (xx - yy) * w[15];
    g[1] += -3 * C3A * (xx - yy) * w[9] + C3B * x * z * w[10] - C3C * (4 * zz - xx - 3 * yy) * w[11] -
            6 * C3D * y * z * w[12] + 2 * C3C * x * y * w[13] - 2 * C3E * y * z * w[14] + 6 * C3A * x * y * w[15];
    g[2] += C3B * x * y * w[10] - 8 * C3C * y * z * w[11] + C3D * (6 * zz - 3 * xx - 3 * yy) * w[12] -
            8 * C3C * x * z * w[13] + C3E * (xx - yy) * w[14];
  }
}

template <int DEGREE>
static void forward_degree(const SphericalHarmonicsJob& job, int64_t begin, int64_t end) {
  constexpr int N = (DEGREE + 1) * (DEGREE + 1);
  for (int64_t g = begin; g < end; g++) {
    float y[N];
    basis<DEGREE>(direction_of(job, g), y);
    const float* sh = job.sh + g * job.coefficients * 3;
    for (int c = 0; c < 3; c++) {
      float sum = 0.5f;
      for (int k = 0; k < N; k++) sum += y[k] * sh[k * 3 + c];
      job.rgb[g * 3 + c] = sum < 0 ? 0.0f : sum;  // NaN stays NaN: the rasterizer culls and counts it
    }
  }
}

template <int DEGREE>
static void backward_degree(const SphericalHarmonicsJob& job, int64_t begin, int64_t end) {
  constexpr int N = (DEGREE + 1) * (DEGREE + 1);
  for (int64_t g = begin; g < end; g++) {
    float y[N], w[N];
    const Direction d = direction_of(job, g);
    basis<DEGREE>(d, y);
    const float* sh = job.sh + g * job.coefficients * 3;
    float* d_sh = job.d_sh + g * job.coefficients * 3;
    float grad[3];
    for (int c = 0; c < 3; c++) {
      float sum = 0.5f;
      for (int k = 0; k < N; k++) sum += y[k] * sh[k * 3 + c];
      grad[c] = sum < 0 ? 0.0f : job.grad[g * 3 + c];
    }
    for (int k = 0; k < N; k++) {
      w[k] = sh[k * 3] * grad[0] + sh[k * 3 + 1] * grad[1] + sh[k * 3 + 2] * grad[2];
      for (int c = 0; c < 3; c++) d_sh[k * 3 + c] = y[k] * grad[c];
    }
    for (int64_t i = N * 3; i < job.coefficients * 3; i++) d_sh[i] = 0;
    float v[3] = {0, 0, 0};
    basis_gradient<DEGREE>(d, w, v);
    const float along = v[0] * d.x + v[1] * d.y + v[2] * d.z;
    job.d_means[g * 3] = (v[0] - d.x * along) * d.inverse;
    job.d_means[g * 3 + 1] = (v[1] - d.y * along) * d.inverse;
    job.d_means[g * 3 + 2] = (v[2] - d.z * along) * d.inverse;
  }
}

static_assert(MAX_SH_DEGREE == 3, "a degree more needs its functions here");

void spherical_harmonics(const SphericalHarmonicsJob& job, int64_t begin, int64_t end) {
  if (job.degree == 0) return forward_degree<0>(job, begin, end);
  if (job.degree == 1) return forward_degree<1>(job, begin, end);
  if (job.degree == 2) return forward_degree<2>(job, begin, end);
  forward_degree<3>(job, begin, end);
}

void spherical_harmonics_backward(const SphericalHarmonicsJob& job, int64_t begin, int64_t end) {
  if (job.degree == 0) return backward_degree<0>(job, begin, end);
  if (job.degree == 1) return backward_degree<1>(job, begin, end);
  if (job.degree == 2) return backward_degree<2>(job, begin, end);
  backward_degree<3>(job, begin, end);
}

}  // namespace FS_NS
