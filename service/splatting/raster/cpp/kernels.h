// Data that kernels and their callers share, and the table of kernels of one instruction set. No std templates here:
// see simd.h.
#pragma once
#include <cstdint>

namespace fs {

constexpr int TILE_H = 16;     // pixels of a tile; its width is the instruction set's own
constexpr int MAX_GROUP = 16;  // feature channels composited in one pass
constexpr int GEOMETRY = 8;    // floats of a record before depth and features: see Projected
constexpr int MOMENTS = 6;     // floats of an intersection's sums before depth and features
constexpr int MAX_SH_DEGREE = 3;
constexpr int MAX_CODE_SIZE = 64;  // numbers of a code that the cross-entropy's buffers hold

// Numbers of slots (depth and channels) that the compositing loops are compiled for, ascending. A group of channels
// takes the first that holds it; the slots beyond read padding and are not written out.
constexpr int SLOT_WIDTHS[] = {1, 4, 5, 7, 8, 9, 12, 17};
constexpr int SLOT_WIDTH_COUNT = sizeof SLOT_WIDTHS / sizeof SLOT_WIDTHS[0];
static_assert(SLOT_WIDTHS[SLOT_WIDTH_COUNT - 1] == MAX_GROUP + 1, "the widest loop must hold a whole group and depth");

struct View {
  double rotation[9], translation[3];  // camera from world
  double fx, fy, cx, cy;
  int32_t width, height;
  double alpha_min, alpha_max, transmittance_min, near_z, far_z, eps2d;
};

struct Inputs {  // [G, ...], contiguous
  const float *means, *quats, *scales, *opacities, *features;
  int64_t count;
  int32_t channels;
};

struct Gradients {  // same shapes as Inputs
  float *means, *quats, *scales, *opacities, *features;
  double* pose;  // of camera-from-world: rotation [9], translation [3]; may be null
};

// A projected, visible Gaussian. Whitened offsets: u = a·dx + b·dy, v = c·dy and alpha = 2^(log_opacity − u² − v²), a
// Cholesky factor of the conic times sqrt(log2(e) / 2): needles keep their digits where the conic itself cancels.
struct Projected {
  double x, y;
  float a, b, c, log_opacity;
  float depth;
  int32_t id;
  // Of the ellipse alpha >= alpha_min: half its extent, and how far below the center its rightmost point lies.
  float half_width, half_height, tip;
};

// Tiles that the Gaussians of one chunk reach, in order of depth.
struct IsectList {
  int32_t* tile;
  uint64_t* blocks;
  int64_t count, capacity;
  float log_alpha_min;  // base 2
};

// One Gaussian in one tile.
struct Isect {
  uint64_t blocks;  // bit = block of the tile; the forward pass drops blocks behind the last open pixel
  uint32_t rank;    // of depth
  uint32_t slot;    // where its sums go: those of one Gaussian are neighbors there
};

struct TileJob {
  View view;
  int32_t tiles_x, tiles_y;
  float log_alpha_min;        // base 2
  const float* records;       // by depth rank: x, y (doubles), a, b, c, log_opacity, depth, features, zeros
  int64_t stride;             // floats
  const int64_t* tile_start;  // [tiles + 1]
  Isect* isects;              // sorted by tile, then depth
  int32_t* tile_used;         // intersections a tile looked at before all its pixels were finished
  float* final_t;             // [tiles, 256], block order
  int32_t* stop;              // [tiles, 256]: index in the tile's list at which a pixel finished
  // The group of channels of this pass.
  int32_t channels, channel_begin, group, first;  // first: the group that also carries depth and alpha
  const float* background;
  int32_t first_row;                                  // image row of the first row of the outputs
  float *image, *alpha, *depth, *median;              // forward outputs
  const float *grad_image, *grad_alpha, *grad_depth;  // may be null; accumulate_weights: grad_image holds the values
  float* sums;                                        // [isects, sum_stride]
  int64_t sum_stride;
};

struct ProjectionBackwardJob {
  View view;
  Inputs in;
  Gradients out;
  const Projected* projected;
  const uint32_t* rank_of;    // physical index of a projected Gaussian -> depth rank
  const int64_t* slot_start;  // [ranks + 1]
  const float* sums;
  int64_t sum_stride;
  double* pose;  // as Gradients::pose, of these rows alone; added to
};

struct SphericalHarmonicsJob {
  const float *means, *sh;  // [G, 3], [G, coefficients, 3]
  int64_t coefficients;
  int32_t degree;
  float camera[3];
  float* rgb;         // [G, 3]
  const float* grad;  // [G, 3]
  float *d_means, *d_sh;
};

constexpr int SSIM_ROWS = 32;        // image rows a task
constexpr int SSIM_TAPS = 11;        // of the window in each direction
constexpr int64_t SSIM_MARGIN = 64;  // floats beside a row that is blurred

// Floats of scratch memory of a task, for rows of `row` floats.
constexpr int64_t ssim_scratch(int64_t row) { return 6 * ((row + 15) / 16 * 16 + 2 * SSIM_MARGIN); }

struct ImageLossJob {
  int32_t height;
  int64_t row;  // floats of an image row: 3 · width
  const float *image, *target;
  const uint8_t* valid;                  // [height, width] or null
  float *d_mean, *d_square, *d_product;  // maps the gradient is blurred from
  float* grad;
  double ssim_weight, scale;  // scale: 1 / counted values
};

// Floats of a row of the surface loss's scratch: whole vectors, and one more.
constexpr int64_t surface_padded(int64_t width) { return (width + 15) / 16 * 16 + 16; }

struct SurfaceJob {
  int32_t height, width, step;  // step: pixels between the three of a bend
  const float *alpha, *depth;
  const float* squared;
  int64_t squared_stride;            // floats from pixel to pixel
  const float* target;               // [height, width, 3]
  const uint8_t* valid;              // [height, width] or null
  float alpha_min;                   // pixels less covered have no depth
  float spread_scale;                // weight / pixels
  float scale_x, scale_y;            // weight / (2 · pixels with both neighbors along the axis)
  float *inverse, *bend_x, *bend_y;  // maps of one channel
  float *d_alpha, *d_depth, *d_squared;
};

constexpr int64_t CROSS_ENTROPY_PIXELS = 4096;  // a task, whatever the number of threads

struct CrossEntropyJob {
  const float *codes, *weight, *bias, *class_weights;
  const int32_t* labels;
  int64_t pixels, code_stride;  // floats from pixel to pixel
  int32_t size, classes;
  double scale;    // 1 / sum of pixel weights
  float* d_codes;  // [pixels, size]
  float* partial;  // [tasks, classes · (size + 1)]: weight and bias gradients of each task
  double* loss;    // [tasks]
};

// Argmax (ties to the lower id) and, on request, Σ softmax · relevancy of weight · code + bias; logits within ±1e30.
struct LabelMapJob {
  const float *weight, *bias, *relevancy;  // [classes, size], [classes], [classes] or null
  int32_t classes, size, skip;             // skip: channels before the code
  float alpha_min;                         // classes of pixels with less are 0
  int32_t* winner;                         // [H, W]
  float *alpha, *expected;                 // [H, W]; expected null without relevancy
  float* image;                            // [H, W, skip]
};

// The label of largest Σ w·share, ties to the lower one, 0 where none is above 0; Gaussian g speaks of the labels
// starts[g]..starts[g + 1].
struct ShareMapJob {
  const int64_t* starts;   // [G + 1]
  const uint16_t* labels;  // [M], all below label_end
  const float* shares;     // [M]
  const int32_t* ids;      // by depth rank: Gaussian
  int32_t label_end;
  float alpha_min;  // labels of pixels with less are 0
  int32_t* winner;  // [H, W]
  float* alpha;     // [H, W]
};

struct LabelWeight {
  uint32_t slot;  // of an intersection
  int32_t label;
  float sum;
};

struct LabelWeightList {
  LabelWeight* data;
  int64_t count, capacity;
  bool (*grow)(LabelWeightList&);  // false: no memory
};

struct AdamJob {
  float *param, *exp_avg, *exp_avg_sq;
  const float* grad;
  float step_size, beta1, beta2, eps, root_correction2;  // step_size: lr over the first bias correction
};

struct Kernels {
  const char* name;
  // Projects rows [begin, end); visible ones go to out[0..]; returns how many. *non_finite counts rows with NaN or Inf.
  int64_t (*project)(const View&, const Inputs&, int64_t begin, int64_t end, Projected* out, int32_t* radii,
                     int64_t* non_finite);
  // Appends the tiles and blocks of one Gaussian; returns false when the list's capacity is reached.
  bool (*tile_ranges)(const View&, const Projected&, IsectList&);
  void (*rasterize_forward)(const TileJob&, int32_t tile);
  void (*rasterize_backward)(const TileJob&, int32_t tile);
  void (*accumulate_weights)(const TileJob&, int32_t tile);
  // Rows [begin, end) of the inputs, of which `visible` are projected: chain rule and zeros for the others.
  void (*projection_backward)(const ProjectionBackwardJob&, int64_t begin, int64_t end, int64_t physical,
                              int64_t visible);
  void (*spherical_harmonics)(const SphericalHarmonicsJob&, int64_t begin, int64_t end);
  void (*spherical_harmonics_backward)(const SphericalHarmonicsJob&, int64_t begin, int64_t end);
  // Bands of SSIM_ROWS rows; scratch holds ssim_scratch(row) floats.
  double (*image_loss)(const ImageLossJob&, int32_t band, float* scratch);
  void (*image_gradient)(const ImageLossJob&, int32_t band, float* scratch);
  void (*cross_entropy)(const CrossEntropyJob&, int64_t task, float* scratch);
  // Each of all rows before the next; scratch holds 2 · surface_padded(width) floats, aligned.
  void (*surface_inverse)(const SurfaceJob&, int32_t row);
  double (*surface_bends)(const SurfaceJob&, int32_t row, float* scratch);
  double (*surface_gradient)(const SurfaceJob&, int32_t row, float* scratch);
  // Composites a tile whose channels all fit into one group, and classifies its pixels.
  void (*label_map)(const TileJob&, const LabelMapJob&, int32_t tile);
  void (*share_map)(const TileJob&, const ShareMapJob&, int32_t tile);
  // Appends, for every intersection of the tile, the sums of its weights by label [H, W]; negative labels do not count.
  bool (*label_sums)(const TileJob&, const int32_t* labels, LabelWeightList&, int32_t tile);
  void (*adam)(const AdamJob&, int64_t begin, int64_t end);
  int32_t lanes, tile_width;
};

// What only the benchmark calls.
struct BenchKernels {
  // After a forward pass: pixel-Gaussian pairs of a tile that count.
  int64_t (*count_contributing)(const TileJob&, int32_t tile);
  // `rounds` times twelve independent chains of fused multiply-adds; returns how many vectors that were.
  int64_t (*peak_fma)(int64_t rounds, float* sink);
};

}  // namespace fs

namespace baseline {
extern const fs::Kernels kernels;
extern const fs::BenchKernels bench_kernels;
}  // namespace baseline
namespace avx2 {
extern const fs::Kernels kernels;
extern const fs::BenchKernels bench_kernels;
}  // namespace avx2
namespace avx512 {
extern const fs::Kernels kernels;
extern const fs::BenchKernels bench_kernels;
}  // namespace avx512
