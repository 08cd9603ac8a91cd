// Bindings of what works on parameters, not pixels: spherical harmonics and Adam.
#include <cmath>

#include "bindings.h"
#include "dispatch.h"
#include "thread_pool.h"

namespace fs {
namespace {

constexpr int64_t ROWS = 4096, ELEMENTS = 16384;  // of a task

using Means = Array<const float, -1, 3>;
using Coefficients = Array<const float, -1, -1, 3>;
using CameraPosition = Array<const float, 3>;
using Rows3 = Array<float, -1, 3>;
using AnyShape = nb::ndarray<float, nb::c_contig, nb::device::cpu>;
using AnyShapeIn = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;

template <class Body>
void for_ranges(int threads, int64_t count, int64_t step, const Body& body) {
  const auto task = [&](int64_t i) { body(i * step, (i + 1) * step < count ? (i + 1) * step : count); };
  parallel_for(threads, (count + step - 1) / step, task, nullptr);
}

SphericalHarmonicsJob make_job(const Means& means, const Coefficients& sh, const CameraPosition& camera_position,
                               int degree) {
  if (means.shape(0) != sh.shape(0)) throw std::invalid_argument("sh: wrong number of rows");
  if (degree < 0 || degree > MAX_SH_DEGREE || (size_t)((degree + 1) * (degree + 1)) > sh.shape(1))
    throw std::invalid_argument("degree: more than the coefficients");
  SphericalHarmonicsJob job{};
  job.means = means.data();
  job.sh = sh.data();
  job.coefficients = (int64_t)sh.shape(1);
  job.degree = degree;
  for (int i = 0; i < 3; i++) job.camera[i] = camera_position.data()[i];
  return job;
}

void spherical_harmonics(const Means& means, const Coefficients& sh, const CameraPosition& camera_position, int degree,
                         const Rows3& rgb, int threads, const std::string& isa) {
  SphericalHarmonicsJob job = make_job(means, sh, camera_position, degree);
  expect(rgb, means.size(), "rgb");
  job.rgb = rgb.data();
  const Kernels& kernels = kernels_for(isa);
  nb::gil_scoped_release release;
  for_ranges(threads, (int64_t)means.shape(0), ROWS,
             [&](int64_t begin, int64_t end) { kernels.spherical_harmonics(job, begin, end); });
}

void spherical_harmonics_backward(const Means& means, const Coefficients& sh, const CameraPosition& camera_position,
                                  int degree, const Means& grad, const Rows3& d_means,
                                  const Array<float, -1, -1, 3>& d_sh, int threads, const std::string& isa) {
  SphericalHarmonicsJob job = make_job(means, sh, camera_position, degree);
  expect(grad, means.size(), "grad");
  expect(d_means, means.size(), "d_means");
  expect(d_sh, sh.size(), "d_sh");
  job.grad = grad.data();
  job.d_means = d_means.data();
  job.d_sh = d_sh.data();
  const Kernels& kernels = kernels_for(isa);
  nb::gil_scoped_release release;
  for_ranges(threads, (int64_t)means.shape(0), ROWS,
             [&](int64_t begin, int64_t end) { kernels.spherical_harmonics_backward(job, begin, end); });
}

void adam(const AnyShape& param, const AnyShapeIn& grad, const AnyShape& exp_avg, const AnyShape& exp_avg_sq, double lr,
          double beta1, double beta2, double eps, int64_t step, int threads, const std::string& isa) {
  expect(grad, param.size(), "grad");
  expect(exp_avg, param.size(), "exp_avg");
  expect(exp_avg_sq, param.size(), "exp_avg_sq");
  if (step < 1) throw std::invalid_argument("step: counts from 1");
  AdamJob job{};
  job.param = param.data();
  job.exp_avg = exp_avg.data();
  job.exp_avg_sq = exp_avg_sq.data();
  job.grad = grad.data();
  job.step_size = (float)(lr / (1.0 - std::pow(beta1, (double)step)));
  job.beta1 = (float)beta1;
  job.beta2 = (float)beta2;
  job.eps = (float)eps;
  job.root_correction2 = (float)std::sqrt(1.0 - std::pow(beta2, (double)step));
  const Kernels& kernels = kernels_for(isa);
  nb::gil_scoped_release release;
  for_ranges(threads, (int64_t)param.size(), ELEMENTS,
             [&](int64_t begin, int64_t end) { kernels.adam(job, begin, end); });
}

}  // namespace

void bind_parameters(nb::module_& m) {
  using nb::arg;
  m.def("spherical_harmonics", &spherical_harmonics, nb::kw_only(), arg("means"), arg("sh"), arg("camera_position"),
        arg("degree"), arg("rgb"), arg("threads"), arg("isa"));
  m.def("spherical_harmonics_backward", &spherical_harmonics_backward, nb::kw_only(), arg("means"), arg("sh"),
        arg("camera_position"), arg("degree"), arg("grad"), arg("d_means"), arg("d_sh"), arg("threads"), arg("isa"));
  m.def("adam", &adam, nb::kw_only(), arg("param"), arg("grad"), arg("exp_avg"), arg("exp_avg_sq"), arg("lr"),
        arg("beta1"), arg("beta2"), arg("eps"), arg("step"), arg("threads"), arg("isa"));
}

}  // namespace fs
