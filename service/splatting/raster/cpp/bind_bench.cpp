// Bindings that only the benchmark uses.
#include <nanobind/stl/pair.h>

#include <algorithm>
#include <chrono>
#include <vector>

#include "bindings.h"
#include "dispatch.h"
#include "thread_pool.h"

namespace fs {
namespace {

std::pair<double, int> peak_fma(int threads, const std::string& isa) {
  const Kernels& kernels = kernels_for(isa);
  const BenchKernels& bench = bench_kernels_for(kernels);
  nb::gil_scoped_release release;
  double best = 0;
  for (int attempt = 0; attempt < 5; attempt++) {
    std::vector<float> sinks(threads * 16, 0.0f);
    std::vector<int64_t> done(threads, 0);
    const auto start = std::chrono::steady_clock::now();
    const auto task = [&](int64_t t) { done[t] = bench.peak_fma(1000000, &sinks[t * 16]); };
    parallel_for(threads, threads, task, nullptr);
    const double ns = std::chrono::duration<double, std::nano>(std::chrono::steady_clock::now() - start).count();
    double total = 0;
    for (int64_t n : done) total += (double)n;
    best = std::max(best, total / ns);
  }
  return {best, kernels.lanes};
}

}  // namespace

void bind_bench(nb::module_& m) {
  m.def(
      "count_contributing", [](const RenderContext& context) { return context.count_contributing(); },
      nb::arg("context"), "Pixel-Gaussian pairs that count in a view after its forward pass.");
  m.def("peak_fma", &peak_fma, nb::arg("threads"), nb::arg("isa"),
        "Vector multiply-adds a nanosecond that `threads` threads reach together, and the lanes of a vector.");
}

}  // namespace fs
