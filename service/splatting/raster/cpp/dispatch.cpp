#include "dispatch.h"

#include <stdexcept>

namespace fs {

static std::vector<const Kernels*> usable() {
  std::vector<const Kernels*> found;
#if defined(FS_X86)
  __builtin_cpu_init();
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
                    __builtin_cpu_supports("bmi2");
  if (avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512bw"))
    found.push_back(&avx512::kernels);
  if (avx2) found.push_back(&avx2::kernels);
#endif
  found.push_back(&baseline::kernels);
  return found;
}

std::vector<std::string> available() {
  std::vector<std::string> names;
  for (const Kernels* k : usable()) names.push_back(k->name);
  return names;
}

const Kernels& kernels(const std::string& isa) {
  static const std::vector<const Kernels*> found = usable();
  if (isa.empty()) return *found.front();
  for (const Kernels* k : found)
    if (isa == k->name) return *k;
  throw std::invalid_argument("this machine cannot run the kernels '" + isa + "'");
}

}  // namespace fs
