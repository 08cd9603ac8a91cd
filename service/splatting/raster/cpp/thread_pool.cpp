#include "thread_pool.h"

#include <pthread.h>

#include <atomic>
#include <condition_variable>
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

constexpr int SPINS = 4000;  // about 100 µs awake after a job: the stages of one call follow each other closely

struct Job {
  const std::function<void(int64_t)>* task;
  int64_t count;
  std::atomic<int64_t> next{0};
  std::atomic<bool> dropped{false};
};

struct Pool {
  std::mutex busy;  // one call at a time; another caller's threads wait here
  std::mutex lock;
  std::condition_variable wake;
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
        running.fetch_sub(1, std::memory_order_acq_rel);
      }
    }
  }

  void grow(int helpers) {
    while ((int)threads.size() < helpers) {
      const int index = (int)threads.size();
      const uint64_t last_generation = generation.load();
      threads.emplace_back([this, index, last_generation] { loop(index, last_generation); });
    }
  }
};

Pool* pool = nullptr;
std::once_flag once;

// Threads do not survive fork, so a child gets a pool of its own. The old one is never freed: threads that no longer
// exist may have locked its mutexes.
void replace_pool() { pool = new Pool; }

Pool& the_pool() {
  std::call_once(once, [] {
    replace_pool();
    pthread_atfork(nullptr, nullptr, replace_pool);
  });
  return *pool;
}

}  // namespace

bool parallel_for(int threads, int64_t count, const std::function<void(int64_t)>& task,
                  const std::function<bool()>& poll) {
  if (count <= 0) return true;
  Job job{&task, count};
  const int helpers = (int)(count < threads ? count : threads) - 1;
  Pool& p = the_pool();
  std::unique_lock<std::mutex> busy(p.busy, std::defer_lock);
  if (helpers > 0) {
    busy.lock();
    p.grow(helpers);
    {
      std::lock_guard<std::mutex> hold(p.lock);
      p.job = &job;
      p.running.store(helpers);
      p.helpers = helpers;
      p.generation.fetch_add(1, std::memory_order_acq_rel);
    }
    p.wake.notify_all();
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
  if (helpers > 0)
    for (int spin = 0; p.running.load(std::memory_order_acquire) > 0; spin++) {
      if (spin < 2000)
        FS_PAUSE();
      else
        std::this_thread::yield();
    }
  return !job.dropped.load();
}

}  // namespace fs
