// The Python module `_cpu`: errors, cancellation, instruction sets, and the bindings of the other files.
#include <nanobind/stl/vector.h>

#include <chrono>

#include "bindings.h"
#include "dispatch.h"

namespace fs {
namespace {

struct TooManyIsectsError : std::runtime_error {
  TooManyIsectsError() : runtime_error("more Gaussian-tile intersections than max_isects") {}
};
struct CallCancelledError : std::runtime_error {
  CallCancelledError() : runtime_error("cancelled") {}
};

// What set_cancellation_check was given. Never freed: threads may call it while the interpreter ends.
PyObject* cancellation_check = nullptr;

// Whether to go on; if not, Python's error indicator may say why. The calling thread holds the GIL.
bool may_continue() {
  if (PyErr_CheckSignals() != 0) return false;
  if (!cancellation_check) return true;
  PyObject* const result = PyObject_CallNoArgs(cancellation_check);
  Py_XDECREF(result);
  return result != nullptr;
}

}  // namespace

Poll make_poll() {
  auto next = std::chrono::steady_clock::now() + std::chrono::milliseconds(50);
  return [next]() mutable {
    const auto now = std::chrono::steady_clock::now();
    if (now < next) return true;
    next = now + std::chrono::milliseconds(50);
    nb::gil_scoped_acquire gil;
    return may_continue();
  };
}

void check(Status status) {
  if (status == Status::too_many_isects) throw TooManyIsectsError();
  if (status == Status::cancelled) {
    nb::gil_scoped_acquire gil;
    if (PyErr_Occurred()) throw nb::python_error();  // Ctrl-C, or what a signal handler or the check raised
    throw CallCancelledError();
  }
}

}  // namespace fs

NB_MODULE(_cpu, m) {
  using namespace fs;
  nb::set_leak_warnings(false);
  m.doc() = "Rasterizer, losses and Adam for the CPU.";
  nb::exception<TooManyIsectsError>(m, "TooManyIsectsError");
  nb::exception<CallCancelledError>(m, "CallCancelledError");
  m.def(
      "set_cancellation_check",
      [](nb::typed<nb::callable, void()> check) { cancellation_check = check.release().ptr(); }, nb::arg("check"),
      "Calls `check` about twenty times a second during long calls; what it raises ends the call.");
  m.def("available_isas", &available_isas, "Instruction sets this machine can run, best first.");
  m.attr("MAX_GROUP") = MAX_GROUP;
  m.attr("MAX_SH_DEGREE") = MAX_SH_DEGREE;
  m.attr("TILE_HEIGHT") = TILE_H;
  bind_render(m);
  bind_losses(m);
  bind_parameters(m);
  bind_bench(m);
}
