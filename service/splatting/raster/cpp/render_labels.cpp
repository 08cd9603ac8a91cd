// Label map of a view, and its sums of blend weights by label: gathered by tile, then merged by Gaussian.
#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <cstring>
#include <new>

#include "render_context.h"
#include "thread_pool.h"

namespace fs {
namespace {

constexpr int64_t PARTS = 64;  // of the tiles, whatever the number of threads

bool grow(LabelWeightList& list) {
  const int64_t capacity = list.capacity ? list.capacity * 2 : 4096;  // a tile has fewer pixels than that
  void* data = std::realloc(list.data, capacity * sizeof(LabelWeight));
  if (!data) return false;
  list.data = static_cast<LabelWeight*>(data);
  list.capacity = capacity;
  return true;
}

// Sorts by label, adds up equal ones in the order they came in. Returns how many are left.
int64_t merge(LabelSum* begin, LabelSum* end) {
  std::stable_sort(begin, end, [](const LabelSum& a, const LabelSum& b) { return a.label < b.label; });
  LabelSum* out = begin;
  for (LabelSum* in = begin; in < end; in++) {
    if (in > begin && out[-1].label == in->label)
      out[-1].sum += in->sum;
    else
      *out++ = *in;
  }
  return out - begin;
}

}  // namespace

Status RenderContext::label_map(const Poll& poll, const LabelMapJob& labels) {
  TileJob job = this->job();
  job.group = channels_;
  job.first = 1;
  const bool done = parallel_for(
      threads_, (int64_t)tiles_x_ * tiles_y_, [&](int64_t tile) { kernels_->label_map(job, labels, (int32_t)tile); },
      poll);
  return done ? Status::done : Status::cancelled;
}

Status RenderContext::share_map(const Poll& poll, ShareMapJob shares) {
  TileJob job = this->job();
  job.first = 1;  // `gather` then takes the depth along, and no feature
  const Projected* projected = space_->projected.data<Projected>();
  const uint32_t* rank_of = space_->rank_of.data<uint32_t>();
  const int64_t* visible_in = space_->visible_in_chunk.data<int64_t>();
  int32_t* ids = space_->ids.get<int32_t>(visible + 1);
  shares.ids = ids;
  bool done = parallel_for(
      threads_, chunks_,
      [&](int64_t c) {
        for (int64_t i = c * CHUNK; i < c * CHUNK + visible_in[c]; i++) ids[rank_of[i]] = projected[i].id;
      },
      poll);
  if (!done) return Status::cancelled;
  done = parallel_for(
      threads_, (int64_t)tiles_x_ * tiles_y_, [&](int64_t tile) { kernels_->share_map(job, shares, (int32_t)tile); },
      poll);
  return done ? Status::done : Status::cancelled;
}

Status RenderContext::label_sums(const Poll& poll, const int32_t* labels, int64_t max_entries, int64_t* starts) {
  const TileJob job = this->job();
  const int64_t tiles = (int64_t)tiles_x_ * tiles_y_;
  std::vector<LabelWeightList>& lists = space_->label_weights;
  if (lists.empty()) lists.resize(PARTS, LabelWeightList{nullptr, 0, 0, grow});
  uint32_t* cursor = space_->cursor.get<uint32_t>(isects + 1);
  std::memset(cursor, 0, (isects + 1) * sizeof(uint32_t));
  std::atomic<int64_t> total{0};
  std::atomic<bool> over_limit{false}, exhausted{false};
  bool done = parallel_for(
      threads_, PARTS,
      [&](int64_t part) {
        LabelWeightList list =
            lists[part];  // a copy while it grows: neighbors share a cache line with another thread's
        list.count = 0;
        for (int64_t tile = tiles * part / PARTS; tile < tiles * (part + 1) / PARTS && !over_limit && !exhausted;
             tile++) {
          const int64_t before = list.count;
          if (!kernels_->label_sums(job, labels, list, (int32_t)tile)) exhausted = true;
          for (int64_t i = before; i < list.count; i++) cursor[list.data[i].slot]++;
          if (total.fetch_add(list.count - before) + list.count - before > max_entries) over_limit = true;
        }
        lists[part] = list;
      },
      poll);
  if (exhausted) throw std::bad_alloc();
  if (over_limit) return Status::too_many_isects;
  if (!done) return Status::cancelled;

  uint32_t at = 0;
  for (int64_t slot = 0; slot <= isects; slot++) {
    const uint32_t n = cursor[slot];
    cursor[slot] = at;
    at += n;
  }
  LabelSum* merged = space_->merged.get<LabelSum>(total);
  done = parallel_for(
      threads_, PARTS,
      [&](int64_t part) {
        const LabelWeightList& list = lists[part];
        for (int64_t i = 0; i < list.count; i++)
          merged[cursor[list.data[i].slot]++] = {(double)list.data[i].sum, list.data[i].label};
      },
      poll);
  if (!done) return Status::cancelled;

  // Each slot's cursor now stands where the next slot begins; the slots of one Gaussian are neighbors.
  const Projected* projected = space_->projected.data<Projected>();
  const uint32_t* rank_of = space_->rank_of.data<uint32_t>();
  const int64_t *slot_start = space_->slot_start.data<int64_t>(),
                *visible_in = space_->visible_in_chunk.data<int64_t>();
  const auto place = [&](int64_t slot) { return slot ? (int64_t)cursor[slot - 1] : 0; };
  std::memset(starts, 0, (count_ + 1) * sizeof(int64_t));
  done = parallel_for(
      threads_, chunks_,
      [&](int64_t c) {
        for (int64_t i = c * CHUNK; i < c * CHUNK + visible_in[c]; i++) {
          const uint32_t rank = rank_of[i];
          starts[projected[i].id + 1] = merge(merged + place(slot_start[rank]), merged + place(slot_start[rank + 1]));
        }
      },
      poll);
  for (int64_t g = 0; g < count_; g++) starts[g + 1] += starts[g];
  return done ? Status::done : Status::cancelled;
}

void RenderContext::label_entries(const int64_t* starts, int32_t* labels, double* sums) const {
  const Projected* projected = space_->projected.data<Projected>();
  const uint32_t *rank_of = space_->rank_of.data<uint32_t>(), *cursor = space_->cursor.data<uint32_t>();
  const int64_t *slot_start = space_->slot_start.data<int64_t>(),
                *visible_in = space_->visible_in_chunk.data<int64_t>();
  const LabelSum* merged = space_->merged.data<LabelSum>();
  for (int64_t c = 0; c < chunks_; c++)
    for (int64_t i = c * CHUNK; i < c * CHUNK + visible_in[c]; i++) {
      const int64_t slot = slot_start[rank_of[i]], begin = starts[projected[i].id];
      const LabelSum* from = merged + (slot ? cursor[slot - 1] : 0);
      for (int64_t n = begin; n < starts[projected[i].id + 1]; n++, from++) {
        labels[n] = from->label;
        sums[n] = from->sum;
      }
    }
}

}  // namespace fs
