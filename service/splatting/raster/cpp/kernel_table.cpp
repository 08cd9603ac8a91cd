// The kernels of one instruction set.
#include "kernels.h"
#include "simd.h"

namespace FS_NS {
using namespace fs;

int64_t project(const View&, const Inputs&, int64_t, int64_t, Projected*, int32_t*, int64_t*);
bool tile_ranges(const View&, const Projected&, IsectList&);
void rasterize_forward(const TileJob&, int32_t);
void rasterize_backward(const TileJob&, int32_t);
void accumulate_weights(const TileJob&, int32_t);
void projection_backward(const ProjectionBackwardJob&, int64_t, int64_t, int64_t, int64_t);
void spherical_harmonics(const SphericalHarmonicsJob&, int64_t, int64_t);
void spherical_harmonics_backward(const SphericalHarmonicsJob&, int64_t, int64_t);
double image_loss(const ImageLossJob&, int32_t, float*);
void image_gradient(const ImageLossJob&, int32_t, float*);
void cross_entropy(const CrossEntropyJob&, int64_t, float*);
void surface_inverse(const SurfaceJob&, int32_t);
double surface_bends(const SurfaceJob&, int32_t, float*);
double surface_gradient(const SurfaceJob&, int32_t, float*);
void label_map(const TileJob&, const LabelMapJob&, int32_t);
void share_map(const TileJob&, const ShareMapJob&, int32_t);
bool label_sums(const TileJob&, const int32_t*, LabelWeightList&, int32_t);
void adam(const AdamJob&, int64_t, int64_t);

#define FS_TEXT(x) #x
#define FS_NAME(x) FS_TEXT(x)
extern const Kernels kernels = {
    FS_NAME(FS_NS),
    project,
    tile_ranges,
    rasterize_forward,
    rasterize_backward,
    accumulate_weights,
    projection_backward,
    spherical_harmonics,
    spherical_harmonics_backward,
    image_loss,
    image_gradient,
    cross_entropy,
    surface_inverse,
    surface_bends,
    surface_gradient,
    label_map,
    share_map,
    label_sums,
    adam,
    W,
    TILE_W,
};

}  // namespace FS_NS
