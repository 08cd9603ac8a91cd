// Python's door. Arrays are numpy views of torch's memory; nothing is copied and torch is not linked.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <chrono>
#include <memory>
#include <stdexcept>

#include "dispatch.h"
#include "pool.h"
#include "raster.h"
#include "training.h"

namespace nb = nanobind;
using fs::Call;
using fs::Frame;
using fs::Status;

using In = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<float, nb::c_contig, nb::device::cpu>;
using OutInt = nb::ndarray<int32_t, nb::c_contig, nb::device::cpu>;
using OutLong = nb::ndarray<int64_t, nb::c_contig, nb::device::cpu>;
using OutDouble = nb::ndarray<double, nb::c_contig, nb::device::cpu>;
using Labels = nb::ndarray<const int32_t, nb::c_contig, nb::device::cpu>;
using Pose = nb::ndarray<const double, nb::shape<4, 4>, nb::c_contig, nb::device::cpu>;

namespace {

struct TooManyPairs : std::runtime_error {
  TooManyPairs() : runtime_error("more Gaussian-tile pairs than max_pairs") {}
};
struct Cancelled : std::runtime_error {
  Cancelled() : runtime_error("cancelled") {}
};

// What `watch` was given. Never freed: threads may look at it while the interpreter ends.
PyObject* watcher = nullptr;

// Whether to go on; if not, Python's error indicator may say why. The calling thread holds the GIL.
bool wanted() {
  if (PyErr_CheckSignals() != 0) return false;
  if (!watcher) return true;
  PyObject* const result = PyObject_CallNoArgs(watcher);
  Py_XDECREF(result);
  return result != nullptr;
}

// The calling thread looks for Ctrl-C, and asks the watcher, about twenty times a second.
std::function<bool()> signals() {
  auto next = std::chrono::steady_clock::now() + std::chrono::milliseconds(50);
  return [next]() mutable {
    const auto now = std::chrono::steady_clock::now();
    if (now < next) return true;
    next = now + std::chrono::milliseconds(50);
    nb::gil_scoped_acquire hold;
    return wanted();
  };
}

void check(Status status) {
  if (status == Status::too_many_pairs) throw TooManyPairs();
  if (status == Status::cancelled) {
    nb::gil_scoped_acquire hold;
    if (PyErr_Occurred()) throw nb::python_error();  // Ctrl-C, or what a signal handler or the watcher raised
    throw Cancelled();
  }
}

template <class Array>
void expect(const Array& array, size_t size, const char* name) {
  if (array.size() != size) throw std::invalid_argument(std::string(name) + ": wrong number of elements");
}

fs::View view_of(const Pose& pose, const std::vector<double>& camera, const std::vector<double>& limits) {
  if (camera.size() != 6 || limits.size() != 6) throw std::invalid_argument("camera or limits");
  fs::View view{};
  for (int i = 0; i < 3; i++) {
    for (int j = 0; j < 3; j++) view.rotation[i * 3 + j] = pose.data()[i * 4 + j];
    view.translation[i] = pose.data()[i * 4 + 3];
  }
  view.width = (int32_t)camera[0];
  view.height = (int32_t)camera[1];
  view.fx = camera[2];
  view.fy = camera[3];
  view.cx = camera[4];
  view.cy = camera[5];
  view.alpha_min = limits[0];
  view.alpha_max = limits[1];
  view.transmittance_min = limits[2];
  view.near_z = limits[3];
  view.far_z = limits[4];
  view.eps2d = limits[5];
  return view;
}

fs::Inputs inputs_of(const In& means, const In& quats, const In& scales, const In& opacities, const In& features) {
  const size_t count = opacities.size();
  expect(means, count * 3, "means");
  expect(quats, count * 4, "quats");
  expect(scales, count * 3, "scales");
  if (features.ndim() != 2 || features.shape(0) != count) throw std::invalid_argument("features: wrong shape");
  return {means.data(), quats.data(), scales.data(), opacities.data(), features.data(), (int64_t)count,
          (int32_t)features.shape(1)};
}

struct Held {
  Frame frame;
  fs::View view;
};

nb::object prepare(const In& means, const In& quats, const In& scales, const In& opacities, const In& features,
                   const Pose& pose, const std::vector<double>& camera, const std::vector<double>& limits,
                   int64_t max_pairs, const OutInt& radii, int threads, const std::string& isa) {
  const fs::Inputs in = inputs_of(means, quats, scales, opacities, features);
  expect(radii, (size_t)in.count, "radii");
  auto held = std::make_unique<Held>();
  held->view = view_of(pose, camera, limits);
  const Call call{&fs::kernels(isa), threads, signals()};
  {
    nb::gil_scoped_release release;
    check(held->frame.prepare(call, held->view, in, max_pairs, radii.data()));
  }
  return nb::cast(held.release(), nb::rv_policy::take_ownership);
}

void forward(Held& held, const In& background, const Out& image, const Out& alpha, const Out& depth, const Out& median,
             int threads, const std::string& isa) {
  const size_t pixels = (size_t)held.view.width * held.view.height;
  expect(alpha, pixels, "alpha");
  expect(depth, pixels, "depth");
  expect(median, pixels, "median");
  expect(image, pixels * background.size(), "image");
  const Call call{&fs::kernels(isa), threads, signals()};
  nb::gil_scoped_release release;
  check(held.frame.forward(call, background.data(), {image.data(), alpha.data(), depth.data(), median.data(), nullptr}));
}

void backward(Held& held, const In& means, const In& quats, const In& scales, const In& opacities, const In& features,
              const In& background, const std::optional<In>& grad_image, const std::optional<In>& grad_alpha,
              const std::optional<In>& grad_depth, const Out& d_means, const Out& d_quats, const Out& d_scales,
              const Out& d_opacities, const Out& d_features, const std::optional<OutDouble>& d_pose, int threads,
              const std::string& isa) {
  const fs::Inputs in = inputs_of(means, quats, scales, opacities, features);
  const size_t pixels = (size_t)held.view.width * held.view.height;
  if (grad_image) expect(*grad_image, pixels * in.channels, "grad_image");
  if (grad_alpha) expect(*grad_alpha, pixels, "grad_alpha");
  if (grad_depth) expect(*grad_depth, pixels, "grad_depth");
  expect(d_means, means.size(), "d_means");
  expect(d_quats, quats.size(), "d_quats");
  expect(d_scales, scales.size(), "d_scales");
  expect(d_opacities, opacities.size(), "d_opacities");
  expect(d_features, features.size(), "d_features");
  if (d_pose) expect(*d_pose, 12, "d_pose");
  const fs::Gradients out{d_means.data(), d_quats.data(), d_scales.data(), d_opacities.data(), d_features.data(),
                          d_pose ? d_pose->data() : nullptr};
  const Call call{&fs::kernels(isa), threads, signals()};
  nb::gil_scoped_release release;
  check(held.frame.backward(call, in, background.data(), grad_image ? grad_image->data() : nullptr,
                            grad_alpha ? grad_alpha->data() : nullptr, grad_depth ? grad_depth->data() : nullptr, out));
}

void blend(Held& held, const In& values, const Out& sums, int threads, const std::string& isa) {
  const size_t pixels = (size_t)held.view.width * held.view.height;
  if (values.ndim() != 3 || values.shape(0) * values.shape(1) != pixels) throw std::invalid_argument("values");
  const Call call{&fs::kernels(isa), threads, signals()};
  nb::gil_scoped_release release;
  check(held.frame.blend(call, values.data(), (int32_t)values.shape(2), sums.data()));
}

void label_map(Held& held, const In& weight, const In& bias, const std::optional<In>& relevancy, double alpha_min,
               const OutInt& classes, const Out& alpha, const std::optional<Out>& expected, const Out& image, int threads,
               const std::string& isa) {
  const size_t pixels = (size_t)held.view.width * held.view.height;
  const int channels = held.frame.channels();
  if (weight.ndim() != 2 || weight.shape(0) != bias.size() || bias.size() < 1) throw std::invalid_argument("weight");
  if (channels > fs::MAX_GROUP || (int)weight.shape(1) > channels) throw std::invalid_argument("channels");
  if (relevancy.has_value() != expected.has_value()) throw std::invalid_argument("expected");
  const int skip = channels - (int)weight.shape(1);
  if (relevancy) expect(*relevancy, bias.size(), "relevancy");
  if (expected) expect(*expected, pixels, "expected");
  expect(classes, pixels, "classes");
  expect(alpha, pixels, "alpha");
  expect(image, pixels * skip, "image");
  const fs::LabelJob job{weight.data(), bias.data(), relevancy ? relevancy->data() : nullptr, (int32_t)bias.size(),
                         (int32_t)weight.shape(1), skip, (float)alpha_min, classes.data(), alpha.data(),
                         expected ? expected->data() : nullptr, image.data()};
  const Call call{&fs::kernels(isa), threads, signals()};
  nb::gil_scoped_release release;
  check(held.frame.label_map(call, job));
}

int64_t label_sums(Held& held, const Labels& labels, int64_t max_entries, const OutLong& starts, int threads,
                   const std::string& isa) {
  expect(labels, (size_t)held.view.width * held.view.height, "labels");
  expect(starts, (size_t)held.frame.count() + 1, "starts");
  const Call call{&fs::kernels(isa), threads, signals()};
  nb::gil_scoped_release release;
  check(held.frame.label_sums(call, labels.data(), max_entries, starts.data()));
  return starts.data()[held.frame.count()];
}

void label_entries(Held& held, const OutLong& starts, const OutInt& labels, const OutDouble& sums) {
  expect(starts, (size_t)held.frame.count() + 1, "starts");
  const size_t entries = (size_t)starts.data()[held.frame.count()];
  expect(labels, entries, "labels");
  expect(sums, entries, "sums");
  nb::gil_scoped_release release;
  held.frame.label_entries(starts.data(), labels.data(), sums.data());
}

int64_t census(Held& held) { return held.frame.census(); }

// Vector multiply-adds a nanosecond that `threads` threads reach together, and the lanes of a vector.
std::pair<double, int> peak(int threads, const std::string& isa) {
  const fs::Kernels& k = fs::kernels(isa);
  nb::gil_scoped_release release;
  double best = 0;
  for (int attempt = 0; attempt < 5; attempt++) {
    std::vector<float> sinks(threads * 16, 0.0f);
    std::vector<int64_t> done(threads, 0);
    const auto start = std::chrono::steady_clock::now();
    fs::run(threads, threads, [&](int64_t t) { done[t] = k.peak(1000000, &sinks[t * 16]); }, nullptr);
    const double ns = std::chrono::duration<double, std::nano>(std::chrono::steady_clock::now() - start).count();
    double total = 0;
    for (int64_t n : done) total += (double)n;
    best = std::max(best, total / ns);
  }
  return {best, k.lanes};
}

}  // namespace

NB_MODULE(_cpu, m) {
  nb::set_leak_warnings(false);
  nb::exception<TooManyPairs>(m, "TooManyPairs");
  nb::exception<Cancelled>(m, "Cancelled");
  m.def("watch", [](nb::object raises) { watcher = raises.release().ptr(); });
  nb::class_<Held>(m, "Frame")
      .def_prop_ro("culled_non_finite", [](const Held& h) { return h.frame.bad; })
      .def_prop_ro("visible", [](const Held& h) { return h.frame.visible; })
      .def_prop_ro("pairs", [](const Held& h) { return h.frame.pairs; })
      .def_prop_ro("milliseconds", [](const Held& h) {
        nb::dict out;
        const char* names[] = {"project", "sort", "bin", "forward", "backward", "finish"};
        for (int i = 0; i < fs::STAGES; i++) out[names[i]] = h.frame.milliseconds[i];
        return out;
      })
      .def("forward", &forward)
      .def("backward", &backward)
      .def("blend", &blend)
      .def("label_map", &label_map)
      .def("label_sums", &label_sums)
      .def("label_entries", &label_entries)
      .def("census", &census);
  m.def("prepare", &prepare);
  m.def("peak", &peak);
  m.attr("MAX_GROUP") = fs::MAX_GROUP;
  bind_training(m);
  m.def("isas", &fs::available, "instruction sets this machine can run, best first");
}
