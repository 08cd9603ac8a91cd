#include "dispatch.h"

#include <stdexcept>

namespace fs {
namespace {

struct Build {
  const Kernels* kernels;
  const BenchKernels* bench;
};

std::vector<Build> usable_builds() {
  std::vector<Build> builds;
#if defined(FS_X86)
  __builtin_cpu_init();
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
                    __builtin_cpu_supports("bmi2");
  const bool avx512 = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
                      __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw");
  if (avx2 && avx512) builds.push_back({&::avx512::kernels, &::avx512::bench_kernels});
  if (avx2) builds.push_back({&::avx2::kernels, &::avx2::bench_kernels});
#endif
  builds.push_back({&::baseline::kernels, &::baseline::bench_kernels});
  return builds;
}

const std::vector<Build>& builds() {
  static const std::vector<Build> list = usable_builds();
  return list;
}

}  // namespace

std::vector<std::string> available_isas() {
  std::vector<std::string> names;
  for (const Build& build : builds()) names.push_back(build.kernels->name);
  return names;
}

const Kernels& kernels_for(const std::string& isa) {
  if (isa.empty()) return *builds().front().kernels;
  for (const Build& build : builds())
    if (isa == build.kernels->name) return *build.kernels;
  throw std::invalid_argument("this machine cannot run the kernels '" + isa + "'");
}

const BenchKernels& bench_kernels_for(const Kernels& kernels) {
  for (const Build& build : builds())
    if (build.kernels == &kernels) return *build.bench;
  throw std::invalid_argument("no benchmark kernels for '" + std::string(kernels.name) + "'");
}

}  // namespace fs
