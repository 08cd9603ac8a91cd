#include "kernels.h"
#include "simd.h"

namespace FS_NS {
using namespace fs;

// Adam (Kingma & Ba 2015) in torch's form: param −= lr/c1 · m / (sqrt(v) / sqrt(c2) + ε).
void adam(const AdamJob& job, int64_t begin, int64_t end) {
  const vf b1 = set1(job.beta1), b2 = set1(job.beta2), a1 = set1(1.0f - job.beta1), a2 = set1(1.0f - job.beta2);
  const vf step = set1(job.step_size), eps = set1(job.eps), root = set1(job.root_correction2);
  int64_t i = begin;
  for (; i + W <= end; i += W) {
    const vf g = loadu(job.grad + i);
    const vf m = fma(b1, loadu(job.exp_avg + i), a1 * g), v = fma(b2, loadu(job.exp_avg_sq + i), a2 * g * g);
    storeu(job.exp_avg + i, m);
    storeu(job.exp_avg_sq + i, v);
    storeu(job.param + i, fnma(step, m / (vsqrt(v) / root + eps), loadu(job.param + i)));
  }
  for (; i < end; i++) {
    const float g = job.grad[i];
    job.exp_avg[i] = job.beta1 * job.exp_avg[i] + (1.0f - job.beta1) * g;
    job.exp_avg_sq[i] = job.beta2 * job.exp_avg_sq[i] + (1.0f - job.beta2) * g * g;
    job.param[i] -=
        job.step_size * (job.exp_avg[i] / (__builtin_sqrtf(job.exp_avg_sq[i]) / job.root_correction2 + job.eps));
  }
}

}  // namespace FS_NS
