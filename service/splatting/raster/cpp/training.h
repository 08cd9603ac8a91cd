// Python bindings of the fused losses, the harmonics and Adam.
#pragma once
#include <nanobind/nanobind.h>

void bind_training(nanobind::module_& m);
