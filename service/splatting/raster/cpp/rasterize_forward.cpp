// The forward pass: composite a tile, write its pixels.
#include "composite.h"

namespace FS_NS {

template <int K>
static void forward_group(const TileJob& job, int32_t tile) {
  const Tile t = tile_of(job, tile);
  Block<K> blocks[BLOCKS];
  composite_tile(job, t, tile, blocks);
  write_pixels<K>(job, t, blocks);
}

void rasterize_forward(const TileJob& job, int32_t tile) {
  with_slot_width(job.group + job.first, [&](auto width) { forward_group<decltype(width)::value>(job, tile); });
}

}  // namespace FS_NS
