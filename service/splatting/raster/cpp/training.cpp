#include "training.h"

#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <cmath>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <vector>

#include "dispatch.h"
#include "pool.h"
#include "raster.h"

namespace nb = nanobind;
using In = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<float, nb::c_contig, nb::device::cpu>;
using Strided = nb::ndarray<const float, nb::ndim<2>, nb::device::cpu>;
using Labels = nb::ndarray<const int32_t, nb::c_contig, nb::device::cpu>;
using Mask = nb::ndarray<const uint8_t, nb::c_contig, nb::device::cpu>;

namespace {

constexpr int64_t ROWS = 4096, ELEMENTS = 16384;  // of a task

template <class Array>
void expect(const Array& array, size_t size, const char* name) {
  if (array.size() != size) throw std::invalid_argument(std::string(name) + ": wrong number of elements");
}

// One piece of scratch memory per task in flight, kept for the next call.
class Scratch {
 public:
  explicit Scratch(int64_t floats) : floats_(floats) {}
  struct Lease {
    std::unique_ptr<fs::Buffer> buffer;
    explicit Lease(std::unique_ptr<fs::Buffer> taken) : buffer(std::move(taken)) {}
    Lease(Lease&&) = default;
    ~Lease() {
      if (!buffer) return;
      std::lock_guard<std::mutex> hold(lock());
      if (idle().size() < 16) idle().push_back(std::move(buffer));
    }
    float* get(int64_t floats) { return buffer->get<float>(floats); }
  };
  Lease lease() const {
    std::lock_guard<std::mutex> hold(lock());
    if (idle().empty()) return Lease(std::make_unique<fs::Buffer>());
    Lease lease(std::move(idle().back()));
    idle().pop_back();
    return lease;
  }
  int64_t floats() const { return floats_; }

 private:
  static std::mutex& lock() {
    static std::mutex mutex;
    return mutex;
  }
  static std::vector<std::unique_ptr<fs::Buffer>>& idle() {
    static auto* buffers = new std::vector<std::unique_ptr<fs::Buffer>>;
    return *buffers;
  }
  int64_t floats_;
};

fs::HarmonicsJob harmonics_job(const In& means, const In& sh, const In& camera, int degree) {
  if (sh.ndim() != 3 || means.size() != sh.shape(0) * 3 || camera.size() != 3) throw std::invalid_argument("sh");
  if (degree < 0 || degree > 3 || (size_t)((degree + 1) * (degree + 1)) > sh.shape(1)) throw std::invalid_argument("degree");
  fs::HarmonicsJob job{};
  job.means = means.data();
  job.sh = sh.data();
  job.coefficients = (int64_t)sh.shape(1);
  job.degree = degree;
  for (int i = 0; i < 3; i++) job.camera[i] = camera.data()[i];
  return job;
}

template <class Body>
void ranges(int threads, int64_t count, int64_t step, const Body& body) {
  fs::run(threads, (count + step - 1) / step,
          [&](int64_t i) { body(i * step, (i + 1) * step < count ? (i + 1) * step : count); }, nullptr);
}

void harmonics(const In& means, const In& sh, const In& camera, int degree, const Out& rgb, int threads,
               const std::string& isa) {
  fs::HarmonicsJob job = harmonics_job(means, sh, camera, degree);
  expect(rgb, means.size(), "rgb");
  job.rgb = rgb.data();
  const fs::Kernels& k = fs::kernels(isa);
  nb::gil_scoped_release release;
  ranges(threads, (int64_t)means.size() / 3, ROWS, [&](int64_t a, int64_t b) { k.harmonics(job, a, b); });
}

void harmonics_backward(const In& means, const In& sh, const In& camera, int degree, const In& grad, const Out& d_means,
                        const Out& d_sh, int threads, const std::string& isa) {
  fs::HarmonicsJob job = harmonics_job(means, sh, camera, degree);
  expect(grad, means.size(), "grad");
  expect(d_means, means.size(), "d_means");
  expect(d_sh, sh.size(), "d_sh");
  job.grad = grad.data();
  job.d_means = d_means.data();
  job.d_sh = d_sh.data();
  const fs::Kernels& k = fs::kernels(isa);
  nb::gil_scoped_release release;
  ranges(threads, (int64_t)means.size() / 3, ROWS, [&](int64_t a, int64_t b) { k.harmonics_backward(job, a, b); });
}

int64_t ssim_scratch(int64_t row) {
  const int64_t stride = (row + 15) / 16 * 16;
  return 3 * (fs::SSIM_ROWS + 10) * stride + 3 * (stride + 128);
}

fs::ImageLossJob image_job(const In& target) {
  if (target.ndim() != 3 || target.shape(2) != 3) throw std::invalid_argument("target: expected [H, W, 3]");
  fs::ImageLossJob job{};
  job.height = (int32_t)target.shape(0);
  job.row = (int64_t)target.shape(1) * 3;
  job.target = target.data();
  return job;
}

void target_moments(const In& target, const Out& mean, const Out& variance, int threads, const std::string& isa) {
  fs::ImageLossJob job = image_job(target);
  expect(mean, target.size(), "mean");
  expect(variance, target.size(), "variance");
  job.mean = mean.data();
  job.variance = variance.data();
  const fs::Kernels& k = fs::kernels(isa);
  nb::gil_scoped_release release;
  Scratch scratch(ssim_scratch(job.row));
  fs::run(threads, (job.height + fs::SSIM_ROWS - 1) / fs::SSIM_ROWS, [&](int64_t band) {
    auto lease = scratch.lease();
    k.target_moments(job, (int32_t)band, lease.get(scratch.floats()));
  }, nullptr);
}

double image_loss(const In& image, const In& target, const Out& mean, const Out& variance, const std::optional<Mask>& valid,
                  double ssim_weight, const std::optional<Out>& grad, int threads, const std::string& isa) {
  fs::ImageLossJob job = image_job(target);
  expect(image, target.size(), "image");
  expect(mean, target.size(), "mean");
  expect(variance, target.size(), "variance");
  if (grad) expect(*grad, target.size(), "grad");
  const size_t pixels = target.size() / 3;
  if (valid) expect(*valid, pixels, "valid");
  job.image = image.data();
  job.mean = mean.data();
  job.variance = variance.data();
  job.valid = valid ? valid->data() : nullptr;
  job.ssim_weight = ssim_weight;
  const fs::Kernels& k = fs::kernels(isa);
  nb::gil_scoped_release release;
  int64_t counted = (int64_t)pixels;
  if (job.valid) {
    counted = 0;
    for (size_t i = 0; i < pixels; i++) counted += job.valid[i] != 0;
  }
  job.scale = counted ? 1.0 / (3.0 * (double)counted) : 0.0;
  Scratch maps(3 * (int64_t)target.size()), scratch(ssim_scratch(job.row));
  auto held = maps.lease();
  job.d_mean = held.get(maps.floats());
  job.d_square = job.d_mean + target.size();
  job.d_product = job.d_square + target.size();
  const int64_t bands = (job.height + fs::SSIM_ROWS - 1) / fs::SSIM_ROWS;
  std::vector<double> losses(bands, 0.0);
  fs::run(threads, bands, [&](int64_t band) {
    auto lease = scratch.lease();
    losses[band] = k.image_loss(job, (int32_t)band, lease.get(scratch.floats()));
  }, nullptr);
  if (grad) {
    job.grad = grad->data();
    fs::run(threads, bands, [&](int64_t band) {
      auto lease = scratch.lease();
      k.image_gradient(job, (int32_t)band, lease.get(scratch.floats()));
    }, nullptr);
  }
  double total = 0;
  for (double loss : losses) total += loss;
  return total;
}

// codes [P, D] may have any stride between pixels, e.g. the last channels of an image.
double semantic_loss(const Strided& codes, const In& weight, const In& bias, const Labels& labels, const In& class_weights,
                     const Out& d_codes, const Out& d_weight, const Out& d_bias, int threads, const std::string& isa) {
  const int64_t pixels = (int64_t)codes.shape(0), size = (int64_t)codes.shape(1), classes = (int64_t)bias.size();
  if (size > 64) throw std::invalid_argument("codes: more than 64 numbers");
  if (size > 1 && codes.stride(1) != 1) throw std::invalid_argument("codes: the last axis must be contiguous");
  expect(weight, (size_t)(classes * size), "weight");
  expect(labels, (size_t)pixels, "labels");
  expect(class_weights, (size_t)classes, "class_weights");
  expect(d_codes, (size_t)(pixels * size), "d_codes");
  expect(d_weight, (size_t)(classes * size), "d_weight");
  expect(d_bias, (size_t)classes, "d_bias");
  fs::SemanticJob job{};
  job.codes = codes.data();
  job.code_stride = pixels > 1 ? codes.stride(0) : size;
  job.weight = weight.data();
  job.bias = bias.data();
  job.class_weights = class_weights.data();
  job.labels = labels.data();
  job.pixels = pixels;
  job.size = (int32_t)size;
  job.classes = (int32_t)classes;
  job.d_codes = d_codes.data();
  const fs::Kernels& k = fs::kernels(isa);
  nb::gil_scoped_release release;
  double total = 0;
  for (int64_t p = 0; p < pixels; p++) {
    const int32_t label = job.labels[p];
    if (label < 0 || label >= classes) throw std::out_of_range("a label outside the classes");
    total += (double)job.class_weights[label];
  }
  job.scale = total > 0 ? 1.0 / total : 0.0;
  const int64_t tasks = (pixels + fs::SEMANTIC_PIXELS - 1) / fs::SEMANTIC_PIXELS, width = classes * (size + 1);
  Scratch partials(tasks * width + 1), scratch(classes * (size + 2) * 16);
  auto held = partials.lease();
  job.partial = held.get(partials.floats());
  std::vector<double> losses(tasks, 0.0);
  job.loss = losses.data();
  fs::run(threads, tasks, [&](int64_t task) {
    auto lease = scratch.lease();
    k.semantic(job, task, lease.get(scratch.floats()));
  }, nullptr);
  for (int64_t c = 0; c < classes; c++)
    for (int64_t d = 0; d <= size; d++) {
      double sum = 0;
      for (int64_t t = 0; t < tasks; t++) sum += job.partial[t * width + c * (size + 1) + d];
      (d < size ? d_weight.data()[c * size + d] : d_bias.data()[c]) = (float)sum;
    }
  double loss = 0;
  for (double l : losses) loss += l;
  return loss * job.scale;
}

void adam(const Out& value, const In& grad, const Out& first, const Out& second, double rate, double beta1, double beta2,
          double epsilon, int64_t step, int threads, const std::string& isa) {
  expect(grad, value.size(), "grad");
  expect(first, value.size(), "first");
  expect(second, value.size(), "second");
  if (step < 1) throw std::invalid_argument("step: counts from 1");
  const fs::AdamJob job{value.data(), first.data(), second.data(), grad.data(),
                        (float)(rate / (1.0 - std::pow(beta1, (double)step))), (float)beta1, (float)beta2, (float)epsilon,
                        (float)std::sqrt(1.0 - std::pow(beta2, (double)step))};
  const fs::Kernels& k = fs::kernels(isa);
  nb::gil_scoped_release release;
  ranges(threads, (int64_t)value.size(), ELEMENTS, [&](int64_t a, int64_t b) { k.adam(job, a, b); });
}

}  // namespace

void bind_training(nb::module_& m) {
  m.def("harmonics", &harmonics);
  m.def("harmonics_backward", &harmonics_backward);
  m.def("target_moments", &target_moments);
  m.def("image_loss", &image_loss);
  m.def("semantic_loss", &semantic_loss);
  m.def("adam", &adam);
}
