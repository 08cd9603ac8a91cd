// Intersections of Gaussians with tiles: sorted by depth, binned by tile.
#include <atomic>
#include <cstdlib>
#include <cstring>
#include <new>
#include <vector>

#include "render_context.h"
#include "thread_pool.h"

namespace fs {

// Stable radix sort by the bits of the (positive) depth, three digits of 11 bits.
Status RenderContext::sort(const Poll& poll) {
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
  bool done = parallel_for(
      threads_, chunks_,
      [&](int64_t c) {
        for (int64_t i = 0; i < visible_in[c]; i++) {
          std::memcpy(keys[0] + first[c] + i, &projected[c * CHUNK + i].depth, 4);
          order[0][first[c] + i] = (uint32_t)(c * CHUNK + i);
        }
      },
      poll);
  const int64_t blocks = visible < 65536 ? 1 : threads_;  // fewer are sorted sooner than threads are woken
  uint32_t* histogram = space_->histogram.get<uint32_t>(blocks * BUCKETS);
  for (int pass = 0; pass < 3 && done; pass++) {
    const int shift = pass * BITS;
    uint32_t *from = keys[pass & 1], *to = keys[~pass & 1], *from_order = order[pass & 1], *to_order = order[~pass & 1];
    done = parallel_for(
        threads_, blocks,
        [&](int64_t b) {
          uint32_t* mine = histogram + b * BUCKETS;
          std::memset(mine, 0, BUCKETS * sizeof(uint32_t));
          for (int64_t i = visible * b / blocks; i < visible * (b + 1) / blocks; i++)
            mine[(from[i] >> shift) & (BUCKETS - 1)]++;
        },
        nullptr);
    uint32_t total = 0;
    for (int d = 0; d < BUCKETS; d++)
      for (int64_t b = 0; b < blocks; b++) {
        const uint32_t n = histogram[b * BUCKETS + d];
        histogram[b * BUCKETS + d] = total;
        total += n;
      }
    done = parallel_for(
        threads_, blocks,
        [&](int64_t b) {
          uint32_t* mine = histogram + b * BUCKETS;
          for (int64_t i = visible * b / blocks; i < visible * (b + 1) / blocks; i++) {
            const uint32_t at = mine[(from[i] >> shift) & (BUCKETS - 1)]++;
            to[at] = from[i];
            to_order[at] = from_order[i];
          }
        },
        poll);
  }
  return done ? Status::done : Status::cancelled;
}

Status RenderContext::bin(const Poll& poll, const Inputs& in, int64_t max_isects) {
  Timer timer(milliseconds[BIN]);
  const int64_t tiles = (int64_t)tiles_x_ * tiles_y_;
  const Projected* projected = space_->projected.data<Projected>();
  const uint32_t* order = space_->order[1].data<uint32_t>();
  uint32_t* rank_of = space_->rank_of.get<uint32_t>(count_);
  float* records = space_->records.get<float>(visible * stride_);
  int64_t* slot_start = space_->slot_start.get<int64_t>(visible + 1);
  int64_t* tile_start = space_->tile_start.get<int64_t>(tiles + 1);
  const int64_t parts = visible < 2048 ? 1 : threads_ * 2;
  uint32_t* counts = space_->counts.get<uint32_t>(parts * tiles);
  std::vector<IsectList>& lists = space_->lists;
  if ((int64_t)lists.size() < parts) lists.resize(parts, IsectList{});
  for (IsectList& list : lists) {
    list.count = 0;
    list.log_alpha_min = log_alpha_min(view_);
  }
  std::atomic<int64_t> total{0};
  std::atomic<bool> over_limit{false}, exhausted{false};

  bool done = parallel_for(
      threads_, parts,
      [&](int64_t part) {
        // A copy while it grows: neighbors in the vector share a cache line with another thread's.
        struct Growing {
          IsectList list;
          IsectList& home;
          ~Growing() { home = list; }
        } growing{lists[part], lists[part]};
        IsectList& list = growing.list;
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
          while (!kernels_->tile_ranges(view_, p, list)) {
            list.count = before;
            const int64_t capacity = list.capacity ? list.capacity * 2 : 4096;
            if (capacity > 2 * max_isects + 8192) {
              over_limit = true;
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
            if (total.fetch_add(unreported, std::memory_order_relaxed) + unreported > max_isects) over_limit = true;
            unreported = 0;
            if (over_limit || exhausted) return;
          }
        }
        if (total.fetch_add(unreported, std::memory_order_relaxed) + unreported > max_isects) over_limit = true;
      },
      poll);
  if (exhausted) throw std::bad_alloc();
  if (over_limit) return Status::too_many_isects;
  if (!done) return Status::cancelled;

  isects = total;
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
  Isect* sorted = space_->isects.get<Isect>(isects);
  done = parallel_for(
      threads_, parts,
      [&](int64_t part) {
        const IsectList& list = lists[part];
        uint32_t* mine = counts + part * tiles;
        int64_t i = 0;
        for (int64_t rank = visible * part / parts; rank < visible * (part + 1) / parts; rank++)
          for (int64_t slot = slot_start[rank]; slot < slot_start[rank + 1]; slot++, i++) {
            sorted[mine[list.tile[i]]++] = {list.blocks[i], (uint32_t)rank, (uint32_t)slot};
          }
      },
      poll);
  return done ? Status::done : Status::cancelled;
}

}  // namespace fs
