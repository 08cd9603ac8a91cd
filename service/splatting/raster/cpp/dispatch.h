// Which kernels this machine can run.
#pragma once
#include <string>
#include <vector>

#include "kernels.h"

namespace fs {

// Best first; always ends with "baseline".
std::vector<std::string> available();

// By name; "" is the best. Throws std::invalid_argument for one this machine cannot run.
const Kernels& kernels(const std::string& isa);

}  // namespace fs
