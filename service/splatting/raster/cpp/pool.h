// Threads of our own: torch's OpenMP team is left alone. The caller works too, so `threads` = 1 starts none.
#pragma once
#include <cstdint>
#include <functional>

namespace fs {

// Calls task(i) for every i < count, on up to `threads` threads; returns when all are done. `poll` is called now and then
// by the calling thread; when it returns false the remaining tasks are dropped and run returns false.
bool run(int threads, int64_t count, const std::function<void(int64_t)>& task, const std::function<bool()>& poll);

}  // namespace fs
