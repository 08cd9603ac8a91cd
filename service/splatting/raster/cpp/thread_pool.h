// Threads of our own: torch's OpenMP team is left alone. The caller works too, so `threads` = 1 starts none. They have
// the caller's niceness; calls of one niceness take turns, calls of different ones run side by side.
#pragma once
#include <cstdint>
#include <functional>

namespace fs {

// Calls task(i) for every i < count, on up to `threads` threads; returns when all are done. The calling thread calls
// `poll` between its tasks; when that returns false the remaining tasks are dropped and parallel_for returns false.
bool parallel_for(int threads, int64_t count, const std::function<void(int64_t)>& task,
                  const std::function<bool()>& poll);

}  // namespace fs
