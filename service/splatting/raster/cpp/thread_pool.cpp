#include "thread_pool.h"

#include <pthread.h>
#include <sys/resource.h>

#include <atomic>
#include <condition_variable>
#include <map>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>
#if defined(__x86_64__)
#include <immintrin.h>
#define FS_PAUSE() _mm_pause()
#else
#define FS_PAUSE() std::this_thread::yield()
#endif

namespace fs {
namespace {

constexpr int SPINS = 4000;       // about 100 µs awake after a job: the stages of one call follow each other closely
constexpr int LAST_SPINS = 2000;  // awake for the helpers' last tasks, which are short if each has a core

struct Job {
  const std::function<void(int64_t)>* task;
  int64_t count;
  std::atomic<int64_t> next{0};
  std::atomic<bool> dropped{false};
};

struct Pool {
  std::mutex busy;  // one call at a time; another caller of the same niceness waits here
  std::mutex lock;
  std::condition_variable wake, ended;
  std::vector<std::thread> threads;
  std::atomic<uint64_t> generation{0};
  std::atomic<int> running{0};
  int helpers = 0;
  Job* job = nullptr;

  static void work(Job& job) {
    for (;;) {
      const int64_t i = job.next.fetch_add(1, std::memory_order_relaxed);
      if (i >= job.count || job.dropped.load(std::memory_order_relaxed)) return;
      (*job.task)(i);
    }
  }

  void loop(int index, uint64_t last_generation) {
    for (;;) {
      for (int spin = 0; generation.load(std::memory_order_acquire) == last_generation && spin < SPINS; spin++)
        FS_PAUSE();
      Job* mine;
      {
        std::unique_lock<std::mutex> hold(lock);
        wake.wait(hold, [&] { return generation.load(std::memory_order_acquire) != last_generation; });
        last_generation = generation.load(std::memory_order_acquire);
        mine = index < helpers ? job : nullptr;
      }
      if (mine) {
        work(*mine);
        if (running.fetch_sub(1, std::memory_order_acq_rel) == 1) {
          std::lock_guard<std::mutex> hold(lock);  // whoever waits has either seen the 0 or waits by now
          ended.notify_one();
        }
      }
    }
  }

  // Returns once no helper is at work. The cores may be others' meanwhile, so this does not spin for long.
  void wait_for_helpers() {
    for (int spin = 0; spin < LAST_SPINS; spin++) {
      if (running.load(std::memory_order_acquire) == 0) return;
      FS_PAUSE();
    }
    std::unique_lock<std::mutex> hold(lock);
    ended.wait(hold, [&] { return running.load(std::memory_order_acquire) == 0; });
  }

  void grow(int helpers) {
    while ((int)threads.size() < helpers) {
      const int index = (int)threads.size();
      const uint64_t last_generation = generation.load();
      threads.emplace_back([this, index, last_generation] { loop(index, last_generation); });
    }
  }
};

// A pool for each niceness of callers: its threads are started by such a caller and inherit it (Linux has it for each
// thread). So a call of a low priority neither holds up one of a higher priority nor takes its core.
struct Pools {
  std::mutex lock;
  std::map<int, Pool> by_niceness;
};

Pools* pools = nullptr;
std::once_flag once;

// Threads do not survive fork, so a child gets pools of its own. The old ones are never freed: threads that no longer
// exist may have locked their mutexes.
void replace_pools() { pools = new Pools; }

Pool& callers_pool() {
  std::call_once(once, [] {
    replace_pools();
    pthread_atfork(nullptr, nullptr, replace_pools);
  });
#if defined(__linux__)
  const int niceness = getpriority(PRIO_PROCESS, 0);  // of the calling thread
#else
  const int niceness = 0;
#endif
  std::lock_guard<std::mutex> hold(pools->lock);
  return pools->by_niceness[niceness];
}

}  // namespace

bool parallel_for(int threads, int64_t count, const std::function<void(int64_t)>& task,
                  const std::function<bool()>& poll) {
  if (count <= 0) return true;
  Job job{&task, count};
  const int helpers = (int)(count < threads ? count : threads) - 1;
  Pool* const pool = helpers > 0 ? &callers_pool() : nullptr;
  std::unique_lock<std::mutex> busy;
  if (pool) {
    busy = std::unique_lock<std::mutex>(pool->busy);
    pool->grow(helpers);
    {
      std::lock_guard<std::mutex> hold(pool->lock);
      pool->job = &job;
      pool->running.store(helpers);
      pool->helpers = helpers;
      pool->generation.fetch_add(1, std::memory_order_acq_rel);
    }
    pool->wake.notify_all();
  }
  for (;;) {
    const int64_t i = job.next.fetch_add(1, std::memory_order_relaxed);
    if (i >= job.count) break;
    if (poll && !poll()) {
      job.dropped.store(true);
      break;
    }
    task(i);
  }
  if (pool) pool->wait_for_helpers();
  return !job.dropped.load();
}

}  // namespace fs
