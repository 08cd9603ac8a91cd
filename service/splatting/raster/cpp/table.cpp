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

#define FS_TEXT(x) #x
#define FS_NAME(x) FS_TEXT(x)
extern const Kernels kernels = {FS_NAME(FS_NS), project, spans, forward, backward, blend, finish};

}  // namespace FS_NS
