#include "raster.h"

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <new>
#include <vector>

#include "pool.h"

namespace fs {
namespace {

constexpr size_t SPARE = 3;      // workspaces kept for the next call: fresh pages cost more than the arithmetic

std::mutex spare_lock;
std::vector<std::unique_ptr<Workspace>> spare;

class Timer {
 public:
  explicit Timer(double& into) : into_(into), start_(std::chrono::steady_clock::now()) {}
  ~Timer() { into_ = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start_).count(); }

 private:
  double& into_;
  std::chrono::steady_clock::time_point start_;
};

// Not below the smallest normal number: the kernels' 2^x ends there.
float log_alpha_min(const View& view) {
  const float value = std::log2((float)view.alpha_min);
  return value > -126.0f ? value : -126.0f;
}

}  // namespace

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
  for (Pairs& list : lists) {
    std::free(list.tile);
    std::free(list.blocks);
  }
  for (LabelEntries& list : entries) std::free(list.data);
}

Frame::Frame() {
  std::lock_guard<std::mutex> hold(spare_lock);
  if (spare.empty()) {
    space_ = std::make_unique<Workspace>();
  } else {
    space_ = std::move(spare.back());
    spare.pop_back();
  }
}

Frame::~Frame() {
  std::lock_guard<std::mutex> hold(spare_lock);
  if (spare.size() < SPARE) spare.push_back(std::move(space_));
}

Status Frame::prepare(const Call& call, const View& view, const Inputs& in, int64_t max_pairs, int32_t* radii) {
  view_ = view;
  kernels_ = call.kernels;  // the other passes must read the tiles as these wrote them
  count_ = in.count;
  channels_ = in.channels;
  tile_width_ = kernels_->tile_width;
  tiles_x_ = (view.width + tile_width_ - 1) / tile_width_;
  tiles_y_ = (view.height + TILE_H - 1) / TILE_H;
  chunks_ = (count_ + CHUNK - 1) / CHUNK;
  // Room for the widest group of slots behind the last feature: the kernels read, and ignore, padding there.
  stride_ = (GEOMETRY + 1 + channels_ + 3) / 4 * 4;
  const int64_t last = channels_ > MAX_GROUP ? GEOMETRY + 1 + (channels_ - 1) / MAX_GROUP * MAX_GROUP + 17 : 0;
  const int64_t widths[] = {1, 4, 5, 7, 8, 9, 12, 17};
  for (int64_t w : widths)
    if (channels_ <= MAX_GROUP && w >= channels_ + 1) {
      stride_ = (GEOMETRY + w + 3) / 4 * 4;
      break;
    }
  if (last > stride_) stride_ = (last + 3) / 4 * 4;

  Projected* projected = space_->projected.get<Projected>(count_);
  int64_t* visible_in = space_->visible_in_chunk.get<int64_t>(chunks_ + 1);
  int64_t* bad_in = space_->bad_in_chunk.get<int64_t>(chunks_ + 1);
  {
    Timer timer(milliseconds[PROJECT]);
    const bool done = run(call.threads, chunks_, [&](int64_t c) {
      const int64_t begin = c * CHUNK, end = begin + CHUNK < count_ ? begin + CHUNK : count_;
      visible_in[c] = kernels_->project(view_, in, begin, end, projected + begin, radii, bad_in + c);
    }, call.poll);
    if (!done) return Status::cancelled;
  }
  visible = bad = 0;
  for (int64_t c = 0; c < chunks_; c++) {
    visible += visible_in[c];
    bad += bad_in[c];
  }
  const Status sorted = sort(call);
  return sorted == Status::done ? bin(call, in, max_pairs) : sorted;
}

// Stable radix sort by the bits of the (positive) depth, three digits of 11 bits.
Status Frame::sort(const Call& call) {
  Timer timer(milliseconds[SORT]);
  constexpr int BITS = 11, BUCKETS = 1 << BITS;
  const Projected* projected = space_->projected.data<Projected>();
  const int64_t* visible_in = space_->visible_in_chunk.data<int64_t>();
  uint32_t *keys[2], *order[2];
  for (int i = 0; i < 2; i++) {
    keys[i] = space_->keys[i].get<uint32_t>(visible);
    order[i] = space_->order[i].get<uint32_t>(visible);
  }
  std::vector<int64_t> first(chunks_ + 1, 0);
  for (int64_t c = 0; c < chunks_; c++) first[c + 1] = first[c] + visible_in[c];
  bool done = run(call.threads, chunks_, [&](int64_t c) {
    for (int64_t i = 0; i < visible_in[c]; i++) {
      std::memcpy(keys[0] + first[c] + i, &projected[c * CHUNK + i].depth, 4);
      order[0][first[c] + i] = (uint32_t)(c * CHUNK + i);
    }
  }, call.poll);
  const int64_t blocks = visible < 65536 ? 1 : call.threads;  // fewer are sorted sooner than threads are woken
  uint32_t* histogram = space_->histogram.get<uint32_t>(blocks * BUCKETS);
  for (int pass = 0; pass < 3 && done; pass++) {
    const int shift = pass * BITS;
    uint32_t *from = keys[pass & 1], *to = keys[~pass & 1], *from_order = order[pass & 1], *to_order = order[~pass & 1];
    done = run(call.threads, blocks, [&](int64_t b) {
      uint32_t* mine = histogram + b * BUCKETS;
      std::memset(mine, 0, BUCKETS * sizeof(uint32_t));
      for (int64_t i = visible * b / blocks; i < visible * (b + 1) / blocks; i++) mine[(from[i] >> shift) & (BUCKETS - 1)]++;
    }, nullptr);
    uint32_t total = 0;
    for (int d = 0; d < BUCKETS; d++)
      for (int64_t b = 0; b < blocks; b++) {
        const uint32_t n = histogram[b * BUCKETS + d];
        histogram[b * BUCKETS + d] = total;
        total += n;
      }
    done = run(call.threads, blocks, [&](int64_t b) {
      uint32_t* mine = histogram + b * BUCKETS;
      for (int64_t i = visible * b / blocks; i < visible * (b + 1) / blocks; i++) {
        const uint32_t at = mine[(from[i] >> shift) & (BUCKETS - 1)]++;
        to[at] = from[i];
        to_order[at] = from_order[i];
      }
    }, call.poll);
  }
  return done ? Status::done : Status::cancelled;
}

Status Frame::bin(const Call& call, const Inputs& in, int64_t max_pairs) {
  Timer timer(milliseconds[BIN]);
  const int64_t tiles = (int64_t)tiles_x_ * tiles_y_;
  const Projected* projected = space_->projected.data<Projected>();
  const uint32_t* order = space_->order[1].data<uint32_t>();
  uint32_t* rank_of = space_->rank_of.get<uint32_t>(count_);
  float* records = space_->records.get<float>(visible * stride_);
  int64_t* slot_start = space_->slot_start.get<int64_t>(visible + 1);
  int64_t* tile_start = space_->tile_start.get<int64_t>(tiles + 1);
  const int64_t parts = visible < 2048 ? 1 : call.threads * 2;
  uint32_t* counts = space_->counts.get<uint32_t>(parts * tiles);
  std::vector<Pairs>& lists = space_->lists;
  if ((int64_t)lists.size() < parts) lists.resize(parts, Pairs{});
  for (Pairs& list : lists) {
    list.count = 0;
    list.log_alpha_min = log_alpha_min(view_);
  }
  std::atomic<int64_t> total{0};
  std::atomic<bool> failed{false}, exhausted{false};

  bool done = run(call.threads, parts, [&](int64_t part) {
    // A copy while it grows: neighbours in the vector share a cache line with another thread's.
    struct Growing {
      Pairs list;
      Pairs& home;
      ~Growing() { home = list; }
    } growing{lists[part], lists[part]};
    Pairs& list = growing.list;
    uint32_t* mine = counts + part * tiles;
    int64_t unreported = 0;
    std::memset(mine, 0, tiles * sizeof(uint32_t));
    for (int64_t rank = visible * part / parts; rank < visible * (part + 1) / parts; rank++) {
      if (rank + 16 < visible) {
        __builtin_prefetch(&projected[order[rank + 16]]);
        __builtin_prefetch(&projected[order[rank + 16]].id);
      }
      if (rank + 8 < visible) __builtin_prefetch(in.features + (int64_t)projected[order[rank + 8]].id * channels_);
      const Projected& p = projected[order[rank]];
      rank_of[order[rank]] = (uint32_t)rank;
      float* record = records + rank * stride_;
      std::memcpy(record, &p, GEOMETRY * sizeof(float) + sizeof(float));  // x, y, a, b, c, log_opacity, depth
      const float* features = in.features + (int64_t)p.id * channels_;
      for (int64_t i = 0; i < channels_; i++) record[GEOMETRY + 1 + i] = features[i];
      for (int64_t i = GEOMETRY + 1 + channels_; i < stride_; i++) record[i] = 0;
      const int64_t before = list.count;
      while (!kernels_->spans(view_, p, list)) {
        list.count = before;
        const int64_t capacity = list.capacity ? list.capacity * 2 : 4096;
        if (capacity > 2 * max_pairs + 8192) {
          failed = true;
          return;
        }
        void *tile = std::realloc(list.tile, capacity * sizeof(int32_t)),
             *blocks = std::realloc(list.blocks, capacity * sizeof(uint64_t));
        if (tile) list.tile = static_cast<int32_t*>(tile);
        if (blocks) list.blocks = static_cast<uint64_t*>(blocks);
        if (!tile || !blocks) {
          exhausted = true;
          return;
        }
        list.capacity = capacity;
      }
      for (int64_t i = before; i < list.count; i++) mine[list.tile[i]]++;
      slot_start[rank] = list.count - before;
      unreported += list.count - before;
      if (unreported > 4096) {
        if (total.fetch_add(unreported, std::memory_order_relaxed) + unreported > max_pairs) failed = true;
        unreported = 0;
        if (failed || exhausted) return;
      }
    }
    if (total.fetch_add(unreported, std::memory_order_relaxed) + unreported > max_pairs) failed = true;
  }, call.poll);
  if (exhausted) throw std::bad_alloc();
  if (failed) return Status::too_many_pairs;
  if (!done) return Status::cancelled;

  pairs = total;
  int64_t at = 0;
  for (int64_t tile = 0; tile < tiles; tile++) {
    tile_start[tile] = at;
    for (int64_t part = 0; part < parts; part++) {
      const uint32_t n = counts[part * tiles + tile];
      counts[part * tiles + tile] = (uint32_t)at;
      at += n;
    }
  }
  tile_start[tiles] = at;
  at = 0;
  for (int64_t rank = 0; rank < visible; rank++) {
    const int64_t n = slot_start[rank];
    slot_start[rank] = at;
    at += n;
  }
  slot_start[visible] = at;
  Pair* sorted = space_->pairs.get<Pair>(pairs);
  done = run(call.threads, parts, [&](int64_t part) {
    const Pairs& list = lists[part];
    uint32_t* mine = counts + part * tiles;
    int64_t i = 0;
    for (int64_t rank = visible * part / parts; rank < visible * (part + 1) / parts; rank++)
      for (int64_t slot = slot_start[rank]; slot < slot_start[rank + 1]; slot++, i++) {
        sorted[mine[list.tile[i]]++] = {list.blocks[i], (uint32_t)rank, (uint32_t)slot};
      }
  }, call.poll);
  return done ? Status::done : Status::cancelled;
}

TileJob Frame::job() const {
  const int64_t tiles = (int64_t)tiles_x_ * tiles_y_;
  TileJob job{};
  job.view = view_;
  job.log_alpha_min = log_alpha_min(view_);
  job.tiles_x = tiles_x_;
  job.tiles_y = tiles_y_;
  job.records = space_->records.data<float>();
  job.stride = stride_;
  job.tile_start = space_->tile_start.data<int64_t>();
  job.pairs = space_->pairs.data<Pair>();
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

Status Frame::forward(const Call& call, const float* background, const Outputs& out) {
  Timer timer(milliseconds[FORWARD]);
  TileJob job = this->job();
  job.background = background;
  job.image = out.image;
  job.alpha = out.alpha;
  job.depth = out.depth;
  job.median = out.median;
  const bool done = each_group(channels_, job, [&] {
    return run(call.threads, (int64_t)tiles_x_ * tiles_y_,
               [&](int64_t tile) { kernels_->forward(job, (int32_t)tile); }, call.poll);
  });
  return done ? Status::done : Status::cancelled;
}

Status Frame::backward(const Call& call, const Inputs& in, const float* background, const float* grad_image,
                       const float* grad_alpha, const float* grad_depth, const Gradients& out) {
  TileJob job = this->job();
  job.background = background;
  job.grad_image = grad_image;
  job.grad_alpha = grad_alpha;
  job.grad_depth = grad_depth;
  job.sum_stride = (MOMENTS + 1 + channels_ + 15) / 16 * 16;
  job.sums = space_->sums.get<float>(pairs * job.sum_stride);
  bool done;
  {
    Timer timer(milliseconds[BACKWARD]);
    done = each_group(channels_, job, [&] {
      return run(call.threads, (int64_t)tiles_x_ * tiles_y_,
                 [&](int64_t tile) { kernels_->backward(job, (int32_t)tile); }, call.poll);
    });
  }
  if (!done) return Status::cancelled;
  Timer timer(milliseconds[FINISH]);
  FinishJob finish{view_, in, out, space_->projected.data<Projected>(), space_->rank_of.data<uint32_t>(),
                   space_->slot_start.data<int64_t>(), job.sums, job.sum_stride, nullptr};
  const int64_t* visible_in = space_->visible_in_chunk.data<int64_t>();
  std::vector<double> poses(out.pose ? chunks_ * 12 : 0, 0.0);
  done = run(call.threads, chunks_, [&](int64_t c) {
    const int64_t begin = c * CHUNK, end = begin + CHUNK < count_ ? begin + CHUNK : count_;
    FinishJob mine = finish;
    if (out.pose) mine.pose = poses.data() + c * 12;
    kernels_->finish(mine, begin, end, begin, visible_in[c]);
  }, call.poll);
  if (out.pose) std::memset(out.pose, 0, 12 * sizeof(double));
  for (size_t i = 0; i < poses.size(); i++) out.pose[i % 12] += poses[i];
  return done ? Status::done : Status::cancelled;
}

int64_t Frame::census() {
  const TileJob job = this->job();
  int64_t useful = 0;
  for (int32_t tile = 0; tile < tiles_x_ * tiles_y_; tile++) useful += kernels_->census(job, tile);
  return useful;
}

Status Frame::blend(const Call& call, const float* values, int32_t width, float* out) {
  TileJob job = this->job();
  job.channels = width;
  job.grad_image = values;
  job.sum_stride = width;
  job.sums = space_->sums.get<float>(pairs * width);
  bool done = each_group(width, job, [&] {
    return run(call.threads, (int64_t)tiles_x_ * tiles_y_,
               [&](int64_t tile) { kernels_->blend(job, (int32_t)tile); }, call.poll);
  });
  if (!done) return Status::cancelled;
  const Projected* projected = space_->projected.data<Projected>();
  const uint32_t* rank_of = space_->rank_of.data<uint32_t>();
  const int64_t *slot_start = space_->slot_start.data<int64_t>(), *visible_in = space_->visible_in_chunk.data<int64_t>();
  std::memset(out, 0, (size_t)count_ * width * sizeof(float));
  done = run(call.threads, chunks_, [&](int64_t c) {
    for (int64_t i = c * CHUNK; i < c * CHUNK + visible_in[c]; i++) {
      float* row = out + (int64_t)projected[i].id * width;
      for (int64_t s = slot_start[rank_of[i]]; s < slot_start[rank_of[i] + 1]; s++)
        for (int32_t v = 0; v < width; v++) row[v] += job.sums[s * width + v];
    }
  }, call.poll);
  return done ? Status::done : Status::cancelled;
}

}  // namespace fs
