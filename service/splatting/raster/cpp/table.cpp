// The kernels of one instruction set.
#include "kernels.h"
#include "simd.h"

namespace FS_NS {
using namespace fs;

int64_t project(const View&, const Inputs&, int64_t, int64_t, Projected*, int32_t*, int64_t*);
bool spans(const View&, const Projected&, Pairs&);
void forward(const TileJob&, int32_t);
void backward(const TileJob&, int32_t);
void blend(const TileJob&, int32_t);
void finish(const FinishJob&, int64_t, int64_t, int64_t, int64_t);
void harmonics(const HarmonicsJob&, int64_t, int64_t);
void harmonics_backward(const HarmonicsJob&, int64_t, int64_t);
void target_moments(const ImageLossJob&, int32_t, float*);
double image_loss(const ImageLossJob&, int32_t, float*);
void image_gradient(const ImageLossJob&, int32_t, float*);
void semantic(const SemanticJob&, int64_t, float*);
void label_tile(const TileJob&, const LabelJob&, int32_t);
bool label_sums(const TileJob&, const int32_t*, LabelEntries&, int32_t);
void adam(const AdamJob&, int64_t, int64_t);
int64_t census(const TileJob&, int32_t);
int64_t peak(int64_t, float*);

#define FS_TEXT(x) #x
#define FS_NAME(x) FS_TEXT(x)
extern const Kernels kernels = {FS_NAME(FS_NS), project, spans, forward, backward, blend, finish,
                                harmonics, harmonics_backward, target_moments, image_loss, image_gradient, semantic,
                                label_tile, label_sums, adam, census, peak, W, TILE_W};

}  // namespace FS_NS
