// Bindings of the losses, with the work divided into tasks.
#include <memory>
#include <mutex>
#include <vector>

#include "bindings.h"
#include "dispatch.h"
#include "thread_pool.h"

namespace fs {
namespace {

using Image = Array<const float, -1, -1, 3>;
using ImageOut = Array<float, -1, -1, 3>;
constexpr int64_t SURFACE_ROWS = 8;  // a task

using Codes = nb::ndarray<const float, nb::shape<-1, -1>, nb::device::cpu>;

// Memory of one purpose: a piece for each task in flight, which stays for the next call.
class ScratchPool {
 public:
  class Lease {
   public:
    Lease(ScratchPool& pool, std::unique_ptr<Buffer> buffer) : pool_(pool), buffer_(std::move(buffer)) {}
    Lease(const Lease&) = delete;
    ~Lease() {
      std::lock_guard<std::mutex> hold(pool_.lock_);
      pool_.idle_.push_back(std::move(buffer_));
    }
    float* get(int64_t floats) { return buffer_->get<float>(floats); }

   private:
    ScratchPool& pool_;
    std::unique_ptr<Buffer> buffer_;
  };
  Lease lease() {
    std::lock_guard<std::mutex> hold(lock_);
    if (idle_.empty()) return Lease(*this, std::make_unique<Buffer>());
    std::unique_ptr<Buffer> buffer = std::move(idle_.back());
    idle_.pop_back();
    return Lease(*this, std::move(buffer));
  }

 private:
  std::mutex lock_;
  std::vector<std::unique_ptr<Buffer>> idle_;
};

// Never freed: threads may run while the interpreter ends.
ScratchPool& image_pool = *new ScratchPool;
ScratchPool& task_pool = *new ScratchPool;

ImageLossJob make_job(const Image& target) {
  ImageLossJob job{};
  job.height = (int32_t)target.shape(0);
  job.row = (int64_t)target.shape(1) * 3;
  job.target = target.data();
  return job;
}

template <class Kernel>
void for_bands(int threads, const ImageLossJob& job, const Kernel& kernel) {
  const auto task = [&](int64_t band) {
    auto lease = task_pool.lease();
    kernel((int32_t)band, lease.get(ssim_scratch(job.row)));
  };
  parallel_for(threads, (job.height + SSIM_ROWS - 1) / SSIM_ROWS, task, nullptr);
}

double image_loss(const Image& image, const Image& target, const std::optional<Array<const uint8_t, -1, -1>>& valid,
                  double ssim_weight, const std::optional<ImageOut>& grad, int threads, const std::string& isa) {
  ImageLossJob job = make_job(target);
  expect(image, target.size(), "image");
  if (grad) expect(*grad, target.size(), "grad");
  const size_t pixels = target.size() / 3;
  if (valid) expect(*valid, pixels, "valid");
  job.image = image.data();
  job.valid = valid ? valid->data() : nullptr;
  job.ssim_weight = ssim_weight;
  const Kernels& kernels = kernels_for(isa);
  nb::gil_scoped_release release;
  int64_t counted = (int64_t)pixels;
  if (job.valid) {
    counted = 0;
    for (size_t i = 0; i < pixels; i++) counted += job.valid[i] != 0;
  }
  job.scale = counted ? 1.0 / (3.0 * (double)counted) : 0.0;
  auto maps = image_pool.lease();
  job.d_mean = maps.get(3 * (int64_t)target.size());
  job.d_square = job.d_mean + target.size();
  job.d_product = job.d_square + target.size();
  std::vector<double> losses((job.height + SSIM_ROWS - 1) / SSIM_ROWS, 0.0);
  for_bands(threads, job, [&](int32_t band, float* scratch) { losses[band] = kernels.image_loss(job, band, scratch); });
  if (grad) {
    job.grad = grad->data();
    for_bands(threads, job, [&](int32_t band, float* scratch) { kernels.image_gradient(job, band, scratch); });
  }
  double total = 0;
  for (double loss : losses) total += loss;
  return total;
}

// codes [P, D] may have any stride between pixels, e.g. the last channels of an image.
double cross_entropy(const Codes& codes, const Array<const float, -1, -1>& weight, const Array<const float, -1>& bias,
                     const Array<const int32_t, -1>& labels, const Array<const float, -1>& class_weights,
                     const Array<float, -1, -1>& d_codes, const Array<float, -1, -1>& d_weight,
                     const Array<float, -1>& d_bias, int threads, const std::string& isa) {
  const int64_t pixels = (int64_t)codes.shape(0), size = (int64_t)codes.shape(1), classes = (int64_t)bias.size();
  if (size > MAX_CODE_SIZE) throw std::invalid_argument("codes: more numbers than MAX_CODE_SIZE");
  if (size > 1 && codes.stride(1) != 1) throw std::invalid_argument("codes: the last axis must be contiguous");
  expect(weight, (size_t)(classes * size), "weight");
  expect(labels, (size_t)pixels, "labels");
  expect(class_weights, (size_t)classes, "class_weights");
  expect(d_codes, (size_t)(pixels * size), "d_codes");
  expect(d_weight, (size_t)(classes * size), "d_weight");
  expect(d_bias, (size_t)classes, "d_bias");
  CrossEntropyJob job{};
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
  const Kernels& kernels = kernels_for(isa);
  nb::gil_scoped_release release;
  double total = 0;
  for (int64_t p = 0; p < pixels; p++) {
    const int32_t label = job.labels[p];
    if (label < 0 || label >= classes) throw std::out_of_range("a label outside the classes");
    total += (double)job.class_weights[label];
  }
  job.scale = total > 0 ? 1.0 / total : 0.0;
  const int64_t tasks = (pixels + CROSS_ENTROPY_PIXELS - 1) / CROSS_ENTROPY_PIXELS, width = classes * (size + 1);
  auto partials = image_pool.lease();
  job.partial = partials.get(tasks * width + 1);
  std::vector<double> losses(tasks, 0.0);
  job.loss = losses.data();
  const auto task = [&](int64_t index) {
    auto lease = task_pool.lease();
    kernels.cross_entropy(job, index, lease.get(classes * (size + 2) * 16));
  };
  parallel_for(threads, tasks, task, nullptr);
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

// squared [H, W] may have any stride between pixels, as the last channel of an image.
double surface_loss(const Array<const float, -1, -1>& alpha, const Array<const float, -1, -1>& depth,
                    const nb::ndarray<const float, nb::shape<-1, -1>, nb::device::cpu>& squared, const Image& target,
                    const std::optional<Array<const uint8_t, -1, -1>>& valid, double alpha_min, int step,
                    double spread_weight, double smoothness_weight, const Array<float, -1, -1>& d_alpha,
                    const Array<float, -1, -1>& d_depth, const Array<float, -1, -1>& d_squared, int threads,
                    const std::string& isa) {
  SurfaceJob job{};
  job.height = (int32_t)alpha.shape(0);
  job.width = (int32_t)alpha.shape(1);
  const size_t pixels = alpha.size();
  expect(depth, pixels, "depth");
  expect(squared, pixels, "squared");
  expect(target, 3 * pixels, "target");
  if (valid) expect(*valid, pixels, "valid");
  expect(d_alpha, pixels, "d_alpha");
  expect(d_depth, pixels, "d_depth");
  expect(d_squared, pixels, "d_squared");
  if (step < 1) throw std::invalid_argument("step: below 1");
  if (job.width > 1 && job.height > 1 && squared.stride(0) != squared.stride(1) * job.width)
    throw std::invalid_argument("squared: rows must follow each other");
  job.step = step;
  job.alpha = alpha.data();
  job.depth = depth.data();
  job.squared = squared.data();
  job.squared_stride = job.width > 1 ? squared.stride(1) : squared.stride(0);
  job.target = target.data();
  job.valid = valid ? valid->data() : nullptr;
  job.alpha_min = (float)alpha_min;
  const double inner_x = (double)job.height * (job.width - 2 * step),
               inner_y = (double)job.width * (job.height - 2 * step);
  job.spread_scale = pixels ? (float)(spread_weight / (double)pixels) : 0.0f;
  job.scale_x = inner_x > 0 ? (float)(smoothness_weight / (2 * inner_x)) : 0.0f;
  job.scale_y = inner_y > 0 ? (float)(smoothness_weight / (2 * inner_y)) : 0.0f;
  job.d_alpha = d_alpha.data();
  job.d_depth = d_depth.data();
  job.d_squared = d_squared.data();
  const Kernels& kernels = kernels_for(isa);
  nb::gil_scoped_release release;
  auto maps = image_pool.lease();
  job.inverse = maps.get(3 * (int64_t)pixels + 1);
  job.bend_x = job.inverse + pixels;
  job.bend_y = job.bend_x + pixels;
  const int64_t bands = (job.height + SURFACE_ROWS - 1) / SURFACE_ROWS;
  std::vector<double> losses(bands, 0.0);
  const auto rows_of = [&](int64_t band, const auto& kernel) {
    auto lease = task_pool.lease();
    float* scratch = lease.get(2 * surface_padded(job.width));
    const int64_t end = (band + 1) * SURFACE_ROWS < job.height ? (band + 1) * SURFACE_ROWS : job.height;
    for (int64_t row = band * SURFACE_ROWS; row < end; row++) kernel((int32_t)row, scratch);
  };
  const auto for_rows = [&](const auto& kernel) {
    parallel_for(threads, bands, [&](int64_t band) { rows_of(band, kernel); }, nullptr);
  };
  for_rows([&](int32_t row, float*) { kernels.surface_inverse(job, row); });
  for_rows(
      [&](int32_t row, float* scratch) { losses[row / SURFACE_ROWS] += kernels.surface_bends(job, row, scratch); });
  for_rows(
      [&](int32_t row, float* scratch) { losses[row / SURFACE_ROWS] += kernels.surface_gradient(job, row, scratch); });
  double total = 0;
  for (double loss : losses) total += loss;
  return total;
}

}  // namespace

void bind_losses(nb::module_& m) {
  using nb::arg;
  m.attr("MAX_CODE_SIZE") = MAX_CODE_SIZE;
  m.def("image_loss", &image_loss, nb::kw_only(), arg("image"), arg("target"), arg("valid").none(), arg("ssim_weight"),
        arg("grad").none(), arg("threads"), arg("isa"));
  m.def("cross_entropy", &cross_entropy, nb::kw_only(), arg("codes"), arg("weight"), arg("bias"), arg("labels"),
        arg("class_weights"), arg("d_codes"), arg("d_weight"), arg("d_bias"), arg("threads"), arg("isa"));
  m.def("surface_loss", &surface_loss, nb::kw_only(), arg("alpha"), arg("depth"), arg("squared"), arg("target"),
        arg("valid").none(), arg("alpha_min"), arg("step"), arg("spread_weight"), arg("smoothness_weight"),
        arg("d_alpha"), arg("d_depth"), arg("d_squared"), arg("threads"), arg("isa"));
}

}  // namespace fs
