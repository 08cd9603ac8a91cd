// Bindings of the rasterizer.
#include <memory>

#include "bindings.h"
#include "dispatch.h"

namespace fs {
namespace {

struct Camera {
  int32_t width, height;
  double fx, fy, cx, cy;
};

struct RasterSettings {
  double alpha_min, alpha_max, transmittance_min, near, far, eps2d;
  int64_t max_isects;
};

using Means = Array<const float, -1, 3>;
using Quats = Array<const float, -1, 4>;
using Scales = Array<const float, -1, 3>;
using Opacities = Array<const float, -1>;
using Features = Array<const float, -1, -1>;
using Viewmat = Array<const double, 4, 4>;
using Image = Array<const float, -1, -1, -1>;
using Plane = Array<const float, -1, -1>;
using ImageOut = Array<float, -1, -1, -1>;
using PlaneOut = Array<float, -1, -1>;

View make_view(const Viewmat& viewmat, const Camera& camera, const RasterSettings& settings) {
  View view{};
  for (int i = 0; i < 3; i++) {
    for (int j = 0; j < 3; j++) view.rotation[i * 3 + j] = viewmat.data()[i * 4 + j];
    view.translation[i] = viewmat.data()[i * 4 + 3];
  }
  view.fx = camera.fx;
  view.fy = camera.fy;
  view.cx = camera.cx;
  view.cy = camera.cy;
  view.width = camera.width;
  view.height = camera.height;
  view.alpha_min = settings.alpha_min;
  view.alpha_max = settings.alpha_max;
  view.transmittance_min = settings.transmittance_min;
  view.near_z = settings.near;
  view.far_z = settings.far;
  view.eps2d = settings.eps2d;
  return view;
}

Inputs make_inputs(const Means& means, const Quats& quats, const Scales& scales, const Opacities& opacities,
                   const Features& features) {
  const size_t count = opacities.size();
  expect(means, count * 3, "means");
  expect(quats, count * 4, "quats");
  expect(scales, count * 3, "scales");
  if (features.shape(0) != count) throw std::invalid_argument("features: wrong number of rows");
  return {means.data(),
          quats.data(),
          scales.data(),
          opacities.data(),
          features.data(),
          (int64_t)count,
          (int32_t)features.shape(1)};
}

size_t pixels_of(const RenderContext& context) { return (size_t)context.view().width * context.view().height; }

RenderContext* prepare(const Means& means, const Quats& quats, const Scales& scales, const Opacities& opacities,
                       const Features& features, const Viewmat& viewmat, const Camera& camera,
                       const RasterSettings& settings, const Array<int32_t, -1>& radii, int threads,
                       const std::string& isa) {
  const Inputs in = make_inputs(means, quats, scales, opacities, features);
  expect(radii, (size_t)in.count, "radii");
  auto context = std::make_unique<RenderContext>(kernels_for(isa), threads);
  const Poll poll = make_poll();
  {
    nb::gil_scoped_release release;
    check(context->prepare(poll, make_view(viewmat, camera, settings), in, settings.max_isects, radii.data()));
  }
  return context.release();
}

void forward(RenderContext& context, const Array<const float, -1>& background, const ImageOut& image,
             const PlaneOut& alpha, const PlaneOut& depth, const PlaneOut& median_depth, int first_row) {
  const View& view = context.view();
  const int rows = (int)image.shape(0), last = first_row + rows;
  if (first_row < 0 || first_row % TILE_H || last > view.height || (rows % TILE_H && last != view.height))
    throw std::invalid_argument("first_row: outputs must be whole rows of tiles");
  const size_t pixels = (size_t)view.width * rows;
  expect(image, pixels * background.size(), "image");
  expect(alpha, pixels, "alpha");
  expect(depth, pixels, "depth");
  expect(median_depth, pixels, "median_depth");
  if ((int)background.size() != context.channels()) throw std::invalid_argument("background: wrong number of channels");
  const TileRows tile_rows{first_row / TILE_H, (last + TILE_H - 1) / TILE_H};
  const Outputs out{image.data(), alpha.data(), depth.data(), median_depth.data()};
  const Poll poll = make_poll();
  nb::gil_scoped_release release;
  check(context.forward(poll, background.data(), tile_rows, out));
}

void backward(RenderContext& context, const Means& means, const Quats& quats, const Scales& scales,
              const Opacities& opacities, const Features& features, const Array<const float, -1>& background,
              const std::optional<Image>& grad_image, const std::optional<Plane>& grad_alpha,
              const std::optional<Plane>& grad_depth, const Array<float, -1, 3>& d_means,
              const Array<float, -1, 4>& d_quats, const Array<float, -1, 3>& d_scales,
              const Array<float, -1>& d_opacities, const Array<float, -1, -1>& d_features,
              const std::optional<Array<double, 12>>& d_pose) {
  const Inputs in = make_inputs(means, quats, scales, opacities, features);
  if (in.count != context.count() || in.channels != context.channels())
    throw std::invalid_argument("not the Gaussians that were prepared");
  const size_t pixels = pixels_of(context);
  expect(background, (size_t)in.channels, "background");
  if (grad_image) expect(*grad_image, pixels * in.channels, "grad_image");
  if (grad_alpha) expect(*grad_alpha, pixels, "grad_alpha");
  if (grad_depth) expect(*grad_depth, pixels, "grad_depth");
  expect(d_means, means.size(), "d_means");
  expect(d_quats, quats.size(), "d_quats");
  expect(d_scales, scales.size(), "d_scales");
  expect(d_opacities, opacities.size(), "d_opacities");
  expect(d_features, features.size(), "d_features");
  const Gradients out{d_means.data(),     d_quats.data(),    d_scales.data(),
                      d_opacities.data(), d_features.data(), d_pose ? d_pose->data() : nullptr};
  const Poll poll = make_poll();
  nb::gil_scoped_release release;
  check(context.backward(poll, in, background.data(), grad_image ? grad_image->data() : nullptr,
                         grad_alpha ? grad_alpha->data() : nullptr, grad_depth ? grad_depth->data() : nullptr, out));
}

void accumulate_weights(RenderContext& context, const Image& values, const Array<float, -1, -1>& sums) {
  if (values.shape(0) * values.shape(1) != pixels_of(context)) throw std::invalid_argument("values: wrong image size");
  expect(sums, (size_t)context.count() * values.shape(2), "sums");
  const Poll poll = make_poll();
  nb::gil_scoped_release release;
  check(context.accumulate_weights(poll, values.data(), (int32_t)values.shape(2), sums.data()));
}

void label_map(RenderContext& context, const Array<const float, -1, -1>& weight, const Array<const float, -1>& bias,
               const std::optional<Array<const float, -1>>& relevancy, double alpha_min,
               const Array<int32_t, -1, -1>& classes, const PlaneOut& alpha, const std::optional<PlaneOut>& expected,
               const ImageOut& image) {
  const size_t pixels = pixels_of(context);
  const int channels = context.channels();
  if (weight.shape(0) != bias.size() || bias.size() < 1) throw std::invalid_argument("weight: wrong number of classes");
  if (channels > MAX_GROUP || (int)weight.shape(1) > channels) throw std::invalid_argument("weight: too many channels");
  if (relevancy.has_value() != expected.has_value()) throw std::invalid_argument("expected: only with relevancy");
  const int skip = channels - (int)weight.shape(1);
  if (relevancy) expect(*relevancy, bias.size(), "relevancy");
  if (expected) expect(*expected, pixels, "expected");
  expect(classes, pixels, "classes");
  expect(alpha, pixels, "alpha");
  expect(image, pixels * skip, "image");
  const LabelMapJob job{weight.data(),
                        bias.data(),
                        relevancy ? relevancy->data() : nullptr,
                        (int32_t)bias.size(),
                        (int32_t)weight.shape(1),
                        skip,
                        (float)alpha_min,
                        classes.data(),
                        alpha.data(),
                        expected ? expected->data() : nullptr,
                        image.data()};
  const Poll poll = make_poll();
  nb::gil_scoped_release release;
  check(context.label_map(poll, job));
}

void share_map(RenderContext& context, const Array<const int64_t, -1>& starts, const Array<const uint16_t, -1>& labels,
               const Array<const float, -1>& shares, double alpha_min, const Array<int32_t, -1, -1>& classes,
               const PlaneOut& alpha) {
  const size_t pixels = pixels_of(context), entries = labels.size();
  expect(starts, (size_t)context.count() + 1, "starts");
  expect(shares, entries, "shares");
  expect(classes, pixels, "classes");
  expect(alpha, pixels, "alpha");
  const int64_t* place = starts.data();
  if (place[0] != 0 || place[context.count()] != (int64_t)entries)
    throw std::invalid_argument("starts: not the entries");
  for (int64_t g = 0; g < context.count(); g++)
    if (place[g + 1] < place[g]) throw std::invalid_argument("starts: must ascend");
  int32_t end = 0;
  for (size_t e = 0; e < entries; e++) end = labels.data()[e] >= end ? labels.data()[e] + 1 : end;
  const ShareMapJob job{starts.data(), labels.data(),    shares.data(),  nullptr,
                        end,           (float)alpha_min, classes.data(), alpha.data()};
  const Poll poll = make_poll();
  nb::gil_scoped_release release;
  check(context.share_map(poll, job));
}

int64_t label_sums(RenderContext& context, const Array<const int32_t, -1, -1>& labels, int64_t max_entries,
                   const Array<int64_t, -1>& starts) {
  expect(labels, pixels_of(context), "labels");
  expect(starts, (size_t)context.count() + 1, "starts");
  const Poll poll = make_poll();
  nb::gil_scoped_release release;
  check(context.label_sums(poll, labels.data(), max_entries, starts.data()));
  return starts.data()[context.count()];
}

void label_entries(const RenderContext& context, const Array<const int64_t, -1>& starts,
                   const Array<int32_t, -1>& labels, const Array<double, -1>& sums) {
  expect(starts, (size_t)context.count() + 1, "starts");
  const size_t entries = (size_t)starts.data()[context.count()];
  expect(labels, entries, "labels");
  expect(sums, entries, "sums");
  nb::gil_scoped_release release;
  context.label_entries(starts.data(), labels.data(), sums.data());
}

using Milliseconds = nb::typed<nb::dict, nb::str, double>;

Milliseconds milliseconds(const RenderContext& context) {
  const char* names[STAGES] = {"project", "sort", "bin", "forward", "backward", "projection_backward"};
  nb::dict out;
  for (int i = 0; i < STAGES; i++) out[names[i]] = context.milliseconds[i];
  return nb::borrow<Milliseconds>(out);
}

}  // namespace

void bind_render(nb::module_& m) {
  using nb::arg;
  nb::class_<Camera>(m, "Camera", "Pinhole intrinsics in pixels.")
      .def(
          "__init__",
          [](Camera* self, int32_t width, int32_t height, double fx, double fy, double cx, double cy) {
            new (self) Camera{width, height, fx, fy, cx, cy};
          },
          nb::kw_only(), arg("width"), arg("height"), arg("fx"), arg("fy"), arg("cx"), arg("cy"))
      .def_ro("width", &Camera::width)
      .def_ro("height", &Camera::height)
      .def_ro("fx", &Camera::fx)
      .def_ro("fy", &Camera::fy)
      .def_ro("cx", &Camera::cx)
      .def_ro("cy", &Camera::cy);
  nb::class_<RasterSettings>(m, "RasterSettings", "As `raster.types.RasterSettings`.")
      .def(
          "__init__",
          [](RasterSettings* self, double alpha_min, double alpha_max, double transmittance_min, double near,
             double far, double eps2d, int64_t max_isects) {
            new (self) RasterSettings{alpha_min, alpha_max, transmittance_min, near, far, eps2d, max_isects};
          },
          nb::kw_only(), arg("alpha_min"), arg("alpha_max"), arg("transmittance_min"), arg("near"), arg("far"),
          arg("eps2d"), arg("max_isects"))
      .def_ro("alpha_min", &RasterSettings::alpha_min)
      .def_ro("alpha_max", &RasterSettings::alpha_max)
      .def_ro("transmittance_min", &RasterSettings::transmittance_min)
      .def_ro("near", &RasterSettings::near)
      .def_ro("far", &RasterSettings::far)
      .def_ro("eps2d", &RasterSettings::eps2d)
      .def_ro("max_isects", &RasterSettings::max_isects);
  nb::class_<RenderContext>(m, "RenderContext", "One prepared view: Gaussians projected, sorted and binned.")
      .def_prop_ro("non_finite", [](const RenderContext& context) { return context.non_finite; })
      .def_prop_ro("visible", [](const RenderContext& context) { return context.visible; })
      .def_prop_ro("isects", [](const RenderContext& context) { return context.isects; })
      .def_prop_ro("milliseconds", &milliseconds)
      .def("forward", &forward, nb::kw_only(), arg("background"), arg("image"), arg("alpha"), arg("depth"),
           arg("median_depth"), arg("first_row") = 0,
           "Composites as many rows as `image` has, from `first_row` on: both whole rows of tiles.")
      .def("backward", &backward, nb::kw_only(), arg("means"), arg("quats"), arg("scales"), arg("opacities"),
           arg("features"), arg("background"), arg("grad_image").none(), arg("grad_alpha").none(),
           arg("grad_depth").none(), arg("d_means"), arg("d_quats"), arg("d_scales"), arg("d_opacities"),
           arg("d_features"), arg("d_pose").none(),
           "Gradients of the inputs; d_pose is that of camera-from-world: rotation [9], translation [3].")
      .def("accumulate_weights", &accumulate_weights, nb::kw_only(), arg("values"), arg("sums"),
           "sums[g] = Σ_p w_g(p)·values(p).")
      .def("label_map", &label_map, nb::kw_only(), arg("weight"), arg("bias"), arg("relevancy").none(),
           arg("alpha_min"), arg("classes"), arg("alpha"), arg("expected").none(), arg("image"))
      .def("share_map", &share_map, nb::kw_only(), arg("starts"), arg("labels"), arg("shares"), arg("alpha_min"),
           arg("classes"), arg("alpha"))
      .def("label_sums", &label_sums, nb::kw_only(), arg("labels"), arg("max_entries"), arg("starts"),
           "Fills `starts` and returns the number of entries.")
      .def("label_entries", &label_entries, nb::kw_only(), arg("starts"), arg("labels"), arg("sums"),
           "The entries of the last `label_sums`.");
  m.def("prepare", &prepare, nb::rv_policy::take_ownership, nb::kw_only(), arg("means"), arg("quats"), arg("scales"),
        arg("opacities"), arg("features"), arg("viewmat"), arg("camera"), arg("settings"), arg("radii"), arg("threads"),
        arg("isa"), "Projects, sorts and bins; fills `radii`.");
}

}  // namespace fs
