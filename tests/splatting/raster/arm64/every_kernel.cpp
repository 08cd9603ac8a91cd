// Calls every kernel of the baseline on a scene that is the same on every machine, and writes what each returns:
// `every_kernel FOLDER` makes files NAME.TYPE there, with TYPE as numpy names it (f4, f8, i4, i8).
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "dispatch.h"
#include "render_context.h"

using namespace fs;

namespace {

std::string folder;

const char* type_of(float) { return "f4"; }
const char* type_of(double) { return "f8"; }
const char* type_of(int32_t) { return "i4"; }
const char* type_of(int64_t) { return "i8"; }

void check(bool held, const char* what) {
  if (held) return;
  std::fprintf(stderr, "%s\n", what);
  std::exit(1);
}

template <class T>
void put(const std::string& name, const std::vector<T>& values) {
  std::FILE* file = std::fopen((folder + "/" + name + "." + type_of(T{})).c_str(), "wb");
  check(file && std::fwrite(values.data(), sizeof(T), values.size(), file) == values.size(),
        "a file cannot be written");
  std::fclose(file);
}

// Multiples of 2^-24 in [0, 1), by a linear congruential generator (Knuth, MMIX).
uint64_t state = 1;
float uniform() {
  state = state * 6364136223846793005u + 1442695040888963407u;
  return (float)(state >> 40) * 0x1p-24f;
}

std::vector<float> uniforms(int64_t count, float low, float high) {
  std::vector<float> out(count);
  for (float& x : out) x = low + uniform() * (high - low);
  return out;
}

std::vector<int32_t> integers(int64_t count, int32_t begin, int32_t end) {
  std::vector<int32_t> out(count);
  for (int32_t& x : out) x = begin + (int32_t)(uniform() * (float)(end - begin));
  return out;
}

constexpr int32_t WIDTH = 83, HEIGHT = 45;  // not whole tiles
constexpr int64_t PIXELS = (int64_t)WIDTH * HEIGHT, COUNT = 400;
const Poll GO_ON = nullptr;

struct Scene {
  std::vector<float> means, quats, scales, opacities;
  View view;
};

Scene make_scene() {
  Scene scene{uniforms(3 * COUNT, -1.5f, 1.5f), uniforms(4 * COUNT, -1, 1), uniforms(3 * COUNT, 0.01f, 0.3f),
              uniforms(COUNT, 0.05f, 0.999f), View{}};
  for (int64_t g = 0; g < COUNT; g++) scene.means[3 * g + 2] += 4;  // a few stay behind the near plane or outside
  scene.view = {{0.96, 0.0, 0.28, 0.0, 1.0, 0.0, -0.28, 0.0, 0.96},
                {-1.1, 0.05, 0.2},
                61.0,
                59.0,
                WIDTH / 2 + 0.7,
                HEIGHT / 2 - 0.4,
                WIDTH,
                HEIGHT,
                1.0 / 255,
                0.999,
                1e-4,
                2.7,
                100.0,
                0.3};
  return scene;
}

void rendering(const Scene& scene, const Kernels& kernels, int32_t channels) {
  const std::string end = "_of_" + std::to_string(channels);
  const std::vector<float> features = uniforms(COUNT * channels, -1, 1), background = uniforms(channels, 0, 1);
  const Inputs in{scene.means.data(),
                  scene.quats.data(),
                  scene.scales.data(),
                  scene.opacities.data(),
                  features.data(),
                  COUNT,
                  channels};
  RenderContext context(kernels, 2);
  std::vector<int32_t> radii(COUNT);
  check(context.prepare(GO_ON, scene.view, in, 1 << 20, radii.data()) == Status::done, "prepare");
  std::vector<float> image(PIXELS * channels), alpha(PIXELS), depth(PIXELS), median(PIXELS);
  check(context.forward(GO_ON, background.data(), context.all_rows(),
                        {image.data(), alpha.data(), depth.data(), median.data()}) == Status::done,
        "forward");
  put("image" + end, image);
  put("alpha" + end, alpha);
  put("depth" + end, depth);
  put("median" + end, median);
  put("radii" + end, radii);
  put("pairs" + end, std::vector<int64_t>{context.visible, context.isects, context.count_contributing()});

  const std::vector<float> grad_image = uniforms(PIXELS * channels, -1, 1), grad_alpha = uniforms(PIXELS, -1, 1),
                           grad_depth = uniforms(PIXELS, -1, 1);
  std::vector<float> d_means(3 * COUNT), d_quats(4 * COUNT), d_scales(3 * COUNT), d_opacities(COUNT),
      d_features(COUNT * channels), weights(COUNT * channels);
  std::vector<double> d_pose(12);
  check(context.backward(GO_ON, in, background.data(), grad_image.data(), grad_alpha.data(), grad_depth.data(),
                         {d_means.data(), d_quats.data(), d_scales.data(), d_opacities.data(), d_features.data(),
                          d_pose.data()}) == Status::done,
        "backward");
  put("d_means" + end, d_means);
  put("d_quats" + end, d_quats);
  put("d_scales" + end, d_scales);
  put("d_opacities" + end, d_opacities);
  put("d_features" + end, d_features);
  put("d_pose" + end, d_pose);
  check(context.accumulate_weights(GO_ON, grad_image.data(), channels, weights.data()) == Status::done, "weights");
  put("weights" + end, weights);
}

void labels(const Scene& scene, const Kernels& kernels) {
  constexpr int32_t CHANNELS = 8, SKIP = 3, SIZE = CHANNELS - SKIP, CLASSES = 7;
  const std::vector<float> features = uniforms(COUNT * CHANNELS, -1, 1);
  const Inputs in{scene.means.data(),
                  scene.quats.data(),
                  scene.scales.data(),
                  scene.opacities.data(),
                  features.data(),
                  COUNT,
                  CHANNELS};
  RenderContext context(kernels, 2);
  std::vector<int32_t> radii(COUNT), winner(PIXELS);
  check(context.prepare(GO_ON, scene.view, in, 1 << 20, radii.data()) == Status::done, "prepare");
  const std::vector<float> weight = uniforms(CLASSES * SIZE, -2, 2), bias = uniforms(CLASSES, -1, 1),
                           relevancy = uniforms(CLASSES, 0, 1);
  std::vector<float> alpha(PIXELS), expected(PIXELS), image(PIXELS * SKIP);
  check(context.label_map(GO_ON, {weight.data(), bias.data(), relevancy.data(), CLASSES, SIZE, SKIP, 0.3f,
                                  winner.data(), alpha.data(), expected.data(), image.data()}) == Status::done,
        "label_map");
  put("label_map", winner);
  put("label_map_alpha", alpha);
  put("label_map_expected", expected);
  put("label_map_image", image);

  std::vector<int64_t> starts(COUNT + 1);
  for (int64_t g = 0; g < COUNT; g++) starts[g + 1] = starts[g] + g % 4;
  std::vector<uint16_t> said(starts[COUNT]);
  for (uint16_t& label : said) label = (uint16_t)(uniform() * 40);
  const std::vector<float> shares = uniforms(starts[COUNT], 0, 1);
  check(context.share_map(GO_ON, {starts.data(), said.data(), shares.data(), nullptr, 40, 0.3f, winner.data(),
                                  alpha.data()}) == Status::done,
        "share_map");
  put("share_map", winner);
  put("share_map_alpha", alpha);

  const std::vector<int32_t> several = integers(PIXELS, -1, 5);
  check(context.label_sums(GO_ON, several.data(), 1 << 20, starts.data()) == Status::done, "label_sums");
  std::vector<int32_t> names(starts[COUNT]);
  std::vector<double> sums(starts[COUNT]), by_label(COUNT * 5);
  context.label_entries(starts.data(), names.data(), sums.data());
  for (int64_t g = 0; g < COUNT; g++)
    for (int64_t n = starts[g]; n < starts[g + 1]; n++) by_label[g * 5 + names[n]] = sums[n];
  put("label_sums", by_label);
}

void losses(const Kernels& kernels) {
  const std::vector<float> image = uniforms(3 * PIXELS, 0, 1), target = uniforms(3 * PIXELS, 0, 1);
  std::vector<uint8_t> valid(PIXELS);
  for (uint8_t& v : valid) v = uniform() < 0.9f;
  std::vector<float> maps(9 * PIXELS), grad(3 * PIXELS);
  Buffer scratch;
  ImageLossJob image_job{HEIGHT,
                         3 * WIDTH,
                         image.data(),
                         target.data(),
                         valid.data(),
                         maps.data(),
                         maps.data() + 3 * PIXELS,
                         maps.data() + 6 * PIXELS,
                         grad.data(),
                         0.2,
                         1.0 / (3 * PIXELS)};
  const int32_t bands = (HEIGHT + SSIM_ROWS - 1) / SSIM_ROWS;
  float* room = scratch.get<float>(ssim_scratch(image_job.row));
  std::vector<double> loss(3);
  for (int32_t band = 0; band < bands; band++) loss[0] += kernels.image_loss(image_job, band, room);
  for (int32_t band = 0; band < bands; band++) kernels.image_gradient(image_job, band, room);
  put("image_loss_gradient", grad);

  constexpr int32_t SIZE = 5, CLASSES = 9;
  const std::vector<float> codes = uniforms(PIXELS * SIZE, -2, 2), weight = uniforms(CLASSES * SIZE, -2, 2),
                           bias = uniforms(CLASSES, -1, 1), class_weights = uniforms(CLASSES, 0.1f, 1);
  const std::vector<int32_t> truth = integers(PIXELS, 0, CLASSES);
  std::vector<float> d_codes(PIXELS * SIZE), partial(CLASSES * (SIZE + 1));
  static_assert(PIXELS <= CROSS_ENTROPY_PIXELS, "one task");
  const CrossEntropyJob entropy{
      codes.data(), weight.data(), bias.data(),  class_weights.data(), truth.data(),   PIXELS,  SIZE,
      SIZE,         CLASSES,       1.0 / PIXELS, d_codes.data(),       partial.data(), &loss[1]};
  kernels.cross_entropy(entropy, 0, scratch.get<float>(CLASSES * (SIZE + 2) * 16));
  put("cross_entropy_codes", d_codes);
  put("cross_entropy_weights", partial);

  const std::vector<float> alpha = uniforms(PIXELS, 0.2f, 1), depth = uniforms(PIXELS, 1, 2),
                           squared = uniforms(PIXELS, 4, 6);
  std::vector<float> inverse(PIXELS), bend_x(PIXELS), bend_y(PIXELS), d_alpha(PIXELS), d_depth(PIXELS),
      d_squared(PIXELS);
  SurfaceJob surface{HEIGHT,
                     WIDTH,
                     2,
                     alpha.data(),
                     depth.data(),
                     squared.data(),
                     1,
                     target.data(),
                     valid.data(),
                     0.3f,
                     1.0f / PIXELS,
                     1.0f / PIXELS,
                     1.0f / PIXELS,
                     inverse.data(),
                     bend_x.data(),
                     bend_y.data(),
                     d_alpha.data(),
                     d_depth.data(),
                     d_squared.data()};
  room = scratch.get<float>(2 * surface_padded(WIDTH));
  for (int32_t y = 0; y < HEIGHT; y++) kernels.surface_inverse(surface, y);
  for (int32_t y = 0; y < HEIGHT; y++) loss[2] += kernels.surface_bends(surface, y, room);
  for (int32_t y = 0; y < HEIGHT; y++) loss[2] += kernels.surface_gradient(surface, y, room);
  put("surface_alpha", d_alpha);
  put("surface_depth", d_depth);
  put("surface_squared", d_squared);
  put("losses", loss);
}

void parameters(const Kernels& kernels) {
  const std::vector<float> means = uniforms(3 * COUNT, -2, 2), sh = uniforms(COUNT * 48, -1, 1),
                           grad = uniforms(3 * COUNT, -1, 1);
  for (int32_t degree = 0; degree <= MAX_SH_DEGREE; degree++) {
    std::vector<float> rgb(3 * COUNT), d_means(3 * COUNT), d_sh(COUNT * 48);
    SphericalHarmonicsJob job{means.data(), sh.data(),      16,         degree, {0.1f, -0.2f, 0.3f}, rgb.data(),
                              grad.data(),  d_means.data(), d_sh.data()};
    kernels.spherical_harmonics(job, 0, COUNT);
    kernels.spherical_harmonics_backward(job, 0, COUNT);
    const std::string end = "_of_degree_" + std::to_string(degree);
    put("harmonics" + end, rgb);
    put("harmonics_means" + end, d_means);
    put("harmonics_sh" + end, d_sh);
  }
  std::vector<float> param = uniforms(COUNT, -1, 1), first = uniforms(COUNT, -1, 1), second = uniforms(COUNT, 0, 1);
  kernels.adam({param.data(), first.data(), second.data(), grad.data(), 1e-3f, 0.9f, 0.999f, 1e-15f, 0.5f}, 0, COUNT);
  put("adam", param);
  put("adam_first", first);
  put("adam_second", second);
}

}  // namespace

int main(int count, char** words) {
  check(count == 2, "every_kernel FOLDER");
  folder = words[1];
  const Kernels& kernels = kernels_for("baseline");
  const Scene scene = make_scene();
  for (const int32_t channels : {3, 4, 6, 7, 8, 11, 16, 20}) rendering(scene, kernels, channels);
  labels(scene, kernels);
  losses(kernels);
  parameters(kernels);
  std::printf("%s %d\n", kernels.name, kernels.lanes);
}
