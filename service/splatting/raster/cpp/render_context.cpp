#include "render_context.h"

#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <new>
#include <vector>

#include "dispatch.h"
#include "thread_pool.h"

namespace fs {
namespace {

constexpr size_t SPARE = 3;  // workspaces kept for the next call: fresh pages cost more than the arithmetic

std::mutex spare_lock;
std::vector<std::unique_ptr<Workspace>> spare;

int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

// Floats of a record: room for the widest group of slots behind the last feature, where the kernels read, and ignore,
// padding.
int64_t record_stride(int32_t channels) {
  const int32_t last_group = channels > MAX_GROUP ? (channels - 1) / MAX_GROUP * MAX_GROUP : 0;
  const int32_t slots = channels > MAX_GROUP ? MAX_GROUP + 1 : channels + 1;
  int width = 0;
  for (int i = 0; i < SLOT_WIDTH_COUNT && width < slots; i++) width = SLOT_WIDTHS[i];
  const int64_t floats = GEOMETRY + (last_group ? 1 + last_group : 0) + width;
  return (floats + 3) / 4 * 4;
}

}  // namespace

Timer::Timer(double& milliseconds) : milliseconds_(milliseconds), start_(now_ns()) {}

Timer::~Timer() { milliseconds_ = (double)(now_ns() - start_) * 1e-6; }

float log_alpha_min(const View& view) {
  const float value = std::log2((float)view.alpha_min);
  return value > -126.0f ? value : -126.0f;
}

Buffer::~Buffer() { std::free(memory_); }

void* Buffer::ensure(int64_t bytes) {
  if (bytes > bytes_ || !memory_) {
    std::free(memory_);
    bytes_ = (bytes + bytes / 4 + 4096) / 64 * 64;
    memory_ = std::aligned_alloc(64, (size_t)bytes_);
    if (!memory_) {
      bytes_ = 0;
      throw std::bad_alloc();
    }
  }
  return memory_;
}

Workspace::~Workspace() {
  for (IsectList& list : lists) {
    std::free(list.tile);
    std::free(list.blocks);
  }
  for (LabelWeightList& list : label_weights) std::free(list.data);
}

RenderContext::RenderContext(const Kernels& kernels, int threads) : kernels_(&kernels), threads_(threads) {
  std::lock_guard<std::mutex> hold(spare_lock);
  if (spare.empty()) {
    space_ = std::make_unique<Workspace>();
  } else {
    space_ = std::move(spare.back());
    spare.pop_back();
  }
}

RenderContext::~RenderContext() {
  std::lock_guard<std::mutex> hold(spare_lock);
  if (spare.size() < SPARE) spare.push_back(std::move(space_));
}

Status RenderContext::prepare(const Poll& poll, const View& view, const Inputs& in, int64_t max_isects,
                              int32_t* radii) {
  view_ = view;
  count_ = in.count;
  channels_ = in.channels;
  tile_width_ = kernels_->tile_width;
  tiles_x_ = (view.width + tile_width_ - 1) / tile_width_;
  tiles_y_ = (view.height + TILE_H - 1) / TILE_H;
  chunks_ = (count_ + CHUNK - 1) / CHUNK;
  stride_ = record_stride(channels_);

  Projected* projected = space_->projected.get<Projected>(count_);
  int64_t* visible_in = space_->visible_in_chunk.get<int64_t>(chunks_ + 1);
  int64_t* non_finite_in = space_->non_finite_in_chunk.get<int64_t>(chunks_ + 1);
  {
    Timer timer(milliseconds[PROJECT]);
    const bool done = parallel_for(
        threads_, chunks_,
        [&](int64_t c) {
          const int64_t begin = c * CHUNK, end = begin + CHUNK < count_ ? begin + CHUNK : count_;
          visible_in[c] = kernels_->project(view_, in, begin, end, projected + begin, radii, non_finite_in + c);
        },
        poll);
    if (!done) return Status::cancelled;
  }
  visible = non_finite = 0;
  for (int64_t c = 0; c < chunks_; c++) {
    visible += visible_in[c];
    non_finite += non_finite_in[c];
  }
  const Status sorted = sort(poll);
  return sorted == Status::done ? bin(poll, in, max_isects) : sorted;
}

TileJob RenderContext::job() const {
  const int64_t tiles = (int64_t)tiles_x_ * tiles_y_;
  TileJob job{};
  job.view = view_;
  job.log_alpha_min = log_alpha_min(view_);
  job.tiles_x = tiles_x_;
  job.tiles_y = tiles_y_;
  job.records = space_->records.data<float>();
  job.stride = stride_;
  job.tile_start = space_->tile_start.data<int64_t>();
  job.isects = space_->isects.data<Isect>();
  job.tile_used = space_->tile_used.get<int32_t>(tiles);
  job.final_t = space_->final_t.get<float>(tiles * tile_width_ * TILE_H);
  job.stop = space_->stop.get<int32_t>(tiles * tile_width_ * TILE_H);
  job.channels = channels_;
  return job;
}

template <class Body>
static bool each_group(int32_t channels, TileJob& job, const Body& body) {
  for (int32_t begin = 0; begin == 0 || begin < channels; begin += MAX_GROUP) {
    job.channel_begin = begin;
    job.group = channels - begin < MAX_GROUP ? channels - begin : MAX_GROUP;
    job.first = begin == 0;
    if (!body()) return false;
  }
  return true;
}

Status RenderContext::forward(const Poll& poll, const float* background, TileRows rows, const Outputs& out) {
  Timer timer(milliseconds[FORWARD]);
  TileJob job = this->job();
  job.background = background;
  job.image = out.image;
  job.alpha = out.alpha;
  job.depth = out.depth;
  job.median = out.median;
  job.first_row = rows.begin * TILE_H;
  const int32_t first_tile = rows.begin * tiles_x_;
  const bool done = each_group(channels_, job, [&] {
    return parallel_for(
        threads_, (int64_t)tiles_x_ * (rows.end - rows.begin),
        [&](int64_t tile) { kernels_->rasterize_forward(job, first_tile + (int32_t)tile); }, poll);
  });
  return done ? Status::done : Status::cancelled;
}

Status RenderContext::backward(const Poll& poll, const Inputs& in, const float* background, const float* grad_image,
                               const float* grad_alpha, const float* grad_depth, const Gradients& out) {
  TileJob job = this->job();
  job.background = background;
  job.grad_image = grad_image;
  job.grad_alpha = grad_alpha;
  job.grad_depth = grad_depth;
  job.sum_stride = (MOMENTS + 1 + channels_ + 15) / 16 * 16;
  job.sums = space_->sums.get<float>(isects * job.sum_stride);
  bool done;
  {
    Timer timer(milliseconds[BACKWARD]);
    done = each_group(channels_, job, [&] {
      return parallel_for(
          threads_, (int64_t)tiles_x_ * tiles_y_,
          [&](int64_t tile) { kernels_->rasterize_backward(job, (int32_t)tile); }, poll);
    });
  }
  if (!done) return Status::cancelled;
  Timer timer(milliseconds[PROJECTION_BACKWARD]);
  const ProjectionBackwardJob projection_job{view_,
                                             in,
                                             out,
                                             space_->projected.data<Projected>(),
                                             space_->rank_of.data<uint32_t>(),
                                             space_->slot_start.data<int64_t>(),
                                             job.sums,
                                             job.sum_stride,
                                             nullptr};
  const int64_t* visible_in = space_->visible_in_chunk.data<int64_t>();
  std::vector<double> poses(out.pose ? chunks_ * 12 : 0, 0.0);
  done = parallel_for(
      threads_, chunks_,
      [&](int64_t c) {
        const int64_t begin = c * CHUNK, end = begin + CHUNK < count_ ? begin + CHUNK : count_;
        ProjectionBackwardJob mine = projection_job;
        if (out.pose) mine.pose = poses.data() + c * 12;
        kernels_->projection_backward(mine, begin, end, begin, visible_in[c]);
      },
      poll);
  if (out.pose) std::memset(out.pose, 0, 12 * sizeof(double));
  for (size_t i = 0; i < poses.size(); i++) out.pose[i % 12] += poses[i];
  return done ? Status::done : Status::cancelled;
}

int64_t RenderContext::count_contributing() const {
  const TileJob job = this->job();
  const BenchKernels& bench = bench_kernels_for(*kernels_);
  int64_t useful = 0;
  for (int32_t tile = 0; tile < tiles_x_ * tiles_y_; tile++) useful += bench.count_contributing(job, tile);
  return useful;
}

Status RenderContext::accumulate_weights(const Poll& poll, const float* values, int32_t width, float* out) {
  TileJob job = this->job();
  job.channels = width;
  job.grad_image = values;
  job.sum_stride = width;
  job.sums = space_->sums.get<float>(isects * width);
  bool done = each_group(width, job, [&] {
    return parallel_for(
        threads_, (int64_t)tiles_x_ * tiles_y_, [&](int64_t tile) { kernels_->accumulate_weights(job, (int32_t)tile); },
        poll);
  });
  if (!done) return Status::cancelled;
  const Projected* projected = space_->projected.data<Projected>();
  const uint32_t* rank_of = space_->rank_of.data<uint32_t>();
  const int64_t *slot_start = space_->slot_start.data<int64_t>(),
                *visible_in = space_->visible_in_chunk.data<int64_t>();
  std::memset(out, 0, (size_t)count_ * width * sizeof(float));
  done = parallel_for(
      threads_, chunks_,
      [&](int64_t c) {
        for (int64_t i = c * CHUNK; i < c * CHUNK + visible_in[c]; i++) {
          float* row = out + (int64_t)projected[i].id * width;
          for (int64_t s = slot_start[rank_of[i]]; s < slot_start[rank_of[i] + 1]; s++)
            for (int32_t v = 0; v < width; v++) row[v] += job.sums[s * width + v];
        }
      },
      poll);
  return done ? Status::done : Status::cancelled;
}

}  // namespace fs
