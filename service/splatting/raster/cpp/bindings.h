// What the bindings share. Arrays are numpy views of torch's memory; nothing is copied and torch is not linked.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <cstdint>
#include <stdexcept>
#include <string>

#include "render_context.h"

namespace fs {

namespace nb = nanobind;

// C-contiguous arrays on the CPU; -1 is any length.
template <class T, nb::ssize_t... SHAPE>
using Array = nb::ndarray<T, nb::shape<SHAPE...>, nb::c_contig, nb::device::cpu>;

template <class AnyArray>
void expect(const AnyArray& array, size_t size, const char* name) {
  if (array.size() != size) throw std::invalid_argument(std::string(name) + ": wrong number of elements");
}

// Looks for signals and asks the cancellation check about twenty times a second. The calling thread need not hold the
// GIL.
Poll make_poll();

// Throws for any status but done. What a signal handler or the cancellation check raised is raised again.
void check(Status status);

void bind_render(nb::module_& m);
void bind_losses(nb::module_& m);
void bind_parameters(nb::module_& m);
void bind_bench(nb::module_& m);

}  // namespace fs
