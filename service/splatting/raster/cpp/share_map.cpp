// The most probable label of every pixel of a tile, where each Gaussian says of a few labels how probable they are.
// A tile shows few labels, however many the scene has: only theirs are added up.
#include "composite.h"

namespace FS_NS {

constexpr int LABELS = 32;      // summed at a time
constexpr int WORDS = 1 << 10;  // of a set of 16-bit labels

// The labels of a tile, ascending.
struct LabelSet {
  uint64_t bits[WORDS];
  uint16_t before[WORDS];  // members of lower words
  int32_t words, count;
};

// What the Gaussians of a part say of the labels of one group: those of j from start[j] to start[j + 1].
struct Shares {
  int32_t start[PART + 1];
  uint8_t label[PART * LABELS];  // within the group
  float share[PART * LABELS];
};

FS_INLINE int32_t gaussian_at(const TileJob& job, const ShareMapJob& map, int64_t isect) {
  return map.ids[job.isects[isect].rank];
}

FS_INLINE void read_set(const TileJob& job, const ShareMapJob& map, const Tile& t, LabelSet& set) {
  set.words = (map.label_end + 63) / 64;
  std::memset(set.bits, 0, set.words * sizeof(uint64_t));
  for (int64_t i = t.begin; i < t.begin + t.count; i++) {
    const int32_t g = gaussian_at(job, map, i);
    for (int64_t e = map.starts[g]; e < map.starts[g + 1]; e++)
      set.bits[map.labels[e] >> 6] |= 1ull << (map.labels[e] & 63);
  }
  set.count = 0;
  for (int32_t w = 0; w < set.words; w++) {
    set.before[w] = (uint16_t)set.count;
    set.count += __builtin_popcountll(set.bits[w]);
  }
}

FS_INLINE int32_t rank_in(const LabelSet& set, uint16_t label) {
  const uint64_t below = set.bits[label >> 6] & ((1ull << (label & 63)) - 1);
  return set.before[label >> 6] + __builtin_popcountll(below);
}

FS_INLINE void read_shares(const TileJob& job, const ShareMapJob& map, const LabelSet& set, int32_t first,
                           int64_t begin, int64_t count, Shares& out) {
  int32_t n = 0;
  for (int64_t j = 0; j < count; j++) {
    const int32_t g = gaussian_at(job, map, begin + j);
    out.start[j] = n;
    for (int64_t e = map.starts[g]; e < map.starts[g + 1]; e++) {
      const int32_t label = rank_in(set, map.labels[e]) - first;
      if (label < 0 || label >= LABELS) continue;
      out.label[n] = (uint8_t)label;
      out.share[n++] = map.shares[e];
    }
  }
  out.start[count] = n;
}

// As `composite`, for sums of labels; other: what finished pixels had left. Returns whether no pixel is open any more.
FS_INLINE bool add_shares(const TileJob& job, const Part<1>& part, const Shares& shares, int index, Block<1>& block,
                          float (*sums)[W]) {
  const vf log_min = set1(job.log_alpha_min), alpha_max = set1((float)job.view.alpha_max);
  const vf x = load(block.x), y = load(block.y);
  vf remaining = load(block.remaining), floor = load(block.extra);
  bool closed = false;
  alignas(64) float alphas[64][W];
  for (int64_t base = 0; base < part.count && !closed; base += 64) {
    int32_t list[64];
    int count = 0;
    for (uint64_t bits = column(part.masks[index / 8] + base, index % 8); bits; bits &= bits - 1) {
      const int32_t j = (int32_t)base + __builtin_ctzll(bits);
      const float *s = part.rows[j], *shape = s + Part<1>::SHAPE;
      const vf u = fma(set1(shape[0]), x, fma(set1(shape[1]), y, set1(s[Part<1>::U])));
      const vf v = fma(set1(shape[2]), y, set1(s[Part<1>::V]));
      const vf exponent = fnma(u, u, fnma(v, v, set1(shape[3])));
      store(alphas[count], keep(ge(exponent, log_min), vmin(exp2_normal(exponent), alpha_max)));
      list[count++] = j;
    }
    for (int n = 0; n < count; n++) {
      const vf alpha = load(alphas[n]);
      vf after = fnma(alpha, remaining, remaining);
      const vm ends = le(after, floor);
      if (__builtin_expect(any(ends), 0)) {
        store(block.other, select(ends, remaining, load(block.other)));
        floor = select(ends, set1(-1.0f), floor);
        remaining = select(ends, zero(), remaining);
        after = select(ends, zero(), after);
        if (!any(gt(remaining, zero()))) {
          closed = true;
          break;
        }
      }
      const vf weight = alpha * remaining;
      for (int32_t e = shares.start[list[n]]; e < shares.start[list[n] + 1]; e++) {
        float* total = sums[shares.label[e]];
        store(total, fma(weight, set1(shares.share[e]), load(total)));
      }
      remaining = after;
    }
  }
  store(block.remaining, remaining);
  store(block.extra, floor);
  return closed;
}

// Adds up the labels `first` to `first + LABELS` of the tile's.
FS_INLINE void sum_group(const TileJob& job, const ShareMapJob& map, const Tile& t, const LabelSet& set, int32_t first,
                         Block<1>* blocks, float (*sums)[LABELS][W]) {
  Part<1> part;
  Shares shares;
  uint64_t open = start_pixels(t, blocks);
  const vf t_min = set1((float)job.view.transmittance_min);
  for (int b = 0; b < BLOCKS; b++) {
    const vm inside = gt(load(blocks[b].remaining), zero());
    store(blocks[b].remaining, keep(inside, set1(1.0f)));
    store(blocks[b].extra, select(inside, t_min, set1(-1.0f)));
    store(blocks[b].other, set1(1.0f));
  }
  std::memset(sums, 0, BLOCKS * sizeof sums[0]);
  for (int64_t start = 0; start < t.count && open; start += PART) {
    gather(job, t, start, part);
    read_shares(job, map, set, first, t.begin + start, part.count, shares);
    for (int b = 0; b < BLOCKS; b++)
      if (open >> b & 1 && add_shares(job, part, shares, b, blocks[b], sums[b])) open &= ~(1ull << b);
  }
}

void share_map(const TileJob& job, const ShareMapJob& map, int32_t tile) {
  const Tile t = tile_of(job, tile);
  Block<1> blocks[BLOCKS];
  LabelSet set;
  alignas(64) float sums[BLOCKS][LABELS][W], best[BLOCKS][W];
  alignas(64) int32_t winner[BLOCKS][W];
  std::memset(best, 0, sizeof best);
  std::memset(winner, 0, sizeof winner);
  read_set(job, map, t, set);
  int32_t rank = 0, word = 0;
  uint64_t bits = set.words ? set.bits[0] : 0;
  do {  // once at least, for the alpha
    const int32_t first = rank;
    sum_group(job, map, t, set, first, blocks, sums);
    for (; rank < set.count && rank < first + LABELS; rank++, bits &= bits - 1) {
      while (!bits) bits = set.bits[++word];
      const vi label = set1i(word * 64 + __builtin_ctzll(bits));
      for (int b = 0; b < BLOCKS; b++) {
        const vf total = load(sums[b][rank - first]);
        const vm more = gt(total, load(best[b]));
        store(best[b], select(more, total, load(best[b])));
        storei(winner[b], selecti(more, label, loadi(winner[b])));
      }
    }
  } while (rank < set.count);
  for (int y = 0; y < t.height; y++)
    for (int x = 0; x < t.width; x++) {
      const int b = block_of(x, y), l = lane_of(x, y);
      const int64_t pixel = (int64_t)(t.y0 + y) * job.view.width + t.x0 + x;
      const float left = blocks[b].remaining[l], alpha = 1.0f - (left > 0 ? left : blocks[b].other[l]);
      map.alpha[pixel] = alpha;
      map.winner[pixel] = alpha >= map.alpha_min ? winner[b][l] : 0;
    }
}

}  // namespace FS_NS
