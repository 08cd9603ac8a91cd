// One view: project, sort, bin, composite; and what of it the backward pass needs.
#pragma once
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "kernels.h"

namespace fs {

// Uninitialised, 64-byte aligned, only ever grows.
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
  std::vector<Pairs> lists;  // malloc'ed arrays, as the entries' are
  std::vector<LabelEntries> entries;
  Buffer projected, visible_in_chunk, bad_in_chunk, keys[2], order[2], histogram, rank_of, records, slot_start, counts, tile_start,
      pairs, tile_used, final_t, stop, sums, cursor, merged;
};

struct Outputs {
  float *image, *alpha, *depth, *median;
  int32_t* radii;
};

struct Call {
  const Kernels* kernels;
  int threads;
  std::function<bool()> poll;
};

enum class Status { done, too_many_pairs, cancelled };

enum Stage { PROJECT, SORT, BIN, FORWARD, BACKWARD, FINISH, STAGES };

class Frame {
 public:
  Frame();
  ~Frame();
  Frame(const Frame&) = delete;

  // Everything up to the tile lists.
  Status prepare(const Call& call, const View& view, const Inputs& in, int64_t max_pairs, int32_t* radii);
  Status forward(const Call& call, const float* background, const Outputs& out);
  Status backward(const Call& call, const Inputs& in, const float* background, const float* grad_image,
                  const float* grad_alpha, const float* grad_depth, const Gradients& out);
  // values [H, W, width] -> out [G, width].
  Status blend(const Call& call, const float* values, int32_t width, float* out);

  // Up to MAX_GROUP channels.
  Status label_map(const Call& call, const LabelJob& labels);
  // labels [H, W]; negative ones do not count. starts [G + 1]: where each Gaussian's entries begin.
  Status label_sums(const Call& call, const int32_t* labels, int64_t max_entries, int64_t* starts);
  // The entries of the last `label_sums`, labels ascending within a Gaussian.
  void label_entries(const int64_t* starts, int32_t* labels, double* sums) const;

  // After forward: pixel-Gaussian pairs that count.
  int64_t census();

  int64_t count() const { return count_; }
  int32_t channels() const { return channels_; }

  int64_t bad = 0, visible = 0, pairs = 0;
  double milliseconds[STAGES] = {};

 private:
  Status sort(const Call& call);
  Status bin(const Call& call, const Inputs& in, int64_t max_pairs);
  TileJob job() const;

  std::unique_ptr<Workspace> space_;
  View view_{};
  const Kernels* kernels_ = nullptr;
  int64_t count_ = 0, chunks_ = 0, stride_ = 0;
  int32_t channels_ = 0, tiles_x_ = 0, tiles_y_ = 0, tile_width_ = 0;
};

}  // namespace fs
