// Which kernels this machine can run.
#pragma once
#include <string>
#include <vector>

#include "kernels.h"

namespace fs {

// Best first; always ends with "baseline".
std::vector<std::string> available_isas();

// By name; "" is the best. Throws std::invalid_argument for one that this machine cannot run.
const Kernels& kernels_for(const std::string& isa);

// The benchmark's kernels of the same instruction set.
const BenchKernels& bench_kernels_for(const Kernels& kernels);

}  // namespace fs
