// One view: project, sort, bin, composite; and what of it the backward pass needs.
#pragma once
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "kernels.h"

namespace fs {

// Uninitialized, 64-byte aligned, only ever grows.
class Buffer {
 public:
  Buffer() = default;
  Buffer(const Buffer&) = delete;
  ~Buffer();
  template <class T>
  T* get(int64_t count) {
    return static_cast<T*>(ensure(count * (int64_t)sizeof(T)));
  }
  template <class T>
  T* data() const {
    return static_cast<T*>(memory_);
  }

 private:
  void* ensure(int64_t bytes);
  void* memory_ = nullptr;
  int64_t bytes_ = 0;
};

constexpr int64_t CHUNK = 4096;  // Gaussians a task

struct LabelSum {
  double sum;
  int32_t label;
};

struct Workspace {
  Workspace() = default;
  Workspace(const Workspace&) = delete;
  ~Workspace();
  std::vector<IsectList> lists;  // malloc'ed arrays, as the label weights' are
  std::vector<LabelWeightList> label_weights;
  Buffer projected, visible_in_chunk, non_finite_in_chunk, keys[2], order[2], histogram, rank_of, records, slot_start;
  Buffer counts, tile_start, isects, tile_used, final_t, stop, sums, cursor, merged, ids;
};

struct Outputs {
  float *image, *alpha, *depth, *median;
};

// Rows of tiles [begin, end).
struct TileRows {
  int32_t begin, end;
};

enum class Status { done, too_many_isects, cancelled };

enum Stage { PROJECT, SORT, BIN, FORWARD, BACKWARD, PROJECTION_BACKWARD, STAGES };

// Whether to go on; called now and then by the calling thread.
using Poll = std::function<bool()>;

class RenderContext {
 public:
  // Every pass uses these kernels, because they read the tiles as the first one wrote them, and this many threads.
  RenderContext(const Kernels& kernels, int threads);
  ~RenderContext();
  RenderContext(const RenderContext&) = delete;

  // Everything up to the tile lists.
  Status prepare(const Poll& poll, const View& view, const Inputs& in, int64_t max_isects, int32_t* radii);
  // Of these rows of tiles; the outputs begin with the first of them.
  Status forward(const Poll& poll, const float* background, TileRows rows, const Outputs& out);
  // After forward of all rows.
  Status backward(const Poll& poll, const Inputs& in, const float* background, const float* grad_image,
                  const float* grad_alpha, const float* grad_depth, const Gradients& out);
  // values [H, W, width] -> out [G, width].
  Status accumulate_weights(const Poll& poll, const float* values, int32_t width, float* out);

  // Up to MAX_GROUP channels.
  Status label_map(const Poll& poll, const LabelMapJob& labels);
  // job.ids are filled in here.
  Status share_map(const Poll& poll, ShareMapJob shares);
  // labels [H, W]; negative ones do not count. starts [G + 1]: where each Gaussian's entries begin.
  Status label_sums(const Poll& poll, const int32_t* labels, int64_t max_entries, int64_t* starts);
  // The entries of the last `label_sums`, labels ascending within a Gaussian.
  void label_entries(const int64_t* starts, int32_t* labels, double* sums) const;

  // After forward: pixel-Gaussian pairs that count.
  int64_t count_contributing() const;

  const View& view() const { return view_; }
  int64_t count() const { return count_; }
  int32_t channels() const { return channels_; }
  TileRows all_rows() const { return {0, tiles_y_}; }

  int64_t non_finite = 0, visible = 0, isects = 0;
  double milliseconds[STAGES] = {};

 private:
  Status sort(const Poll& poll);
  Status bin(const Poll& poll, const Inputs& in, int64_t max_isects);
  TileJob job() const;

  const Kernels* kernels_;
  int threads_;
  std::unique_ptr<Workspace> space_;
  View view_{};
  int64_t count_ = 0, chunks_ = 0, stride_ = 0;
  int32_t channels_ = 0, tiles_x_ = 0, tiles_y_ = 0, tile_width_ = 0;
};

// Measures a stage in milliseconds.
class Timer {
 public:
  explicit Timer(double& milliseconds);
  ~Timer();

 private:
  double& milliseconds_;
  int64_t start_;
};

// Of a view, base 2; not below the smallest normal number, where the kernels' 2^x ends.
float log_alpha_min(const View& view);

}  // namespace fs
