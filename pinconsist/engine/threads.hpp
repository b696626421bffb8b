// Threads that wait for work.
#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>

namespace pinconsist {

// The calling thread works, too, and waits only for those that are at work: on a busy machine others may come late, or
// never, as in a process that was forked.
class Threads {
public:
  Threads() = default;
  Threads(const Threads &) = delete;
  ~Threads() {
    const std::lock_guard hold(shared_->mutex);
    shared_->ended = true;
    shared_->wake.notify_all();
  }

  // Calls work(thread, item) for all items, on so many threads at most.
  template <class Work> void each(size_t items, size_t threads, const Work &work) {
    std::atomic<size_t> next{0};
    const std::function<void(size_t)> loop = [&](size_t thread) {
      for (size_t item = next++; item < items; item = next++) work(thread, item);
    };
    if (threads < 2 || items < 2) return loop(0);
    while (started_ + 1 < threads) std::thread(wait_for_work, shared_, ++started_).detach();
    {
      const std::lock_guard hold(shared_->mutex);
      shared_->work = &loop;
      ++shared_->number;
    }
    shared_->wake.notify_all();
    loop(0);
    std::unique_lock hold(shared_->mutex);
    shared_->work = nullptr;
    shared_->done.wait(hold, [&] { return shared_->busy == 0; });
  }

private:
  struct Shared {
    std::mutex mutex;
    std::condition_variable wake, done;
    const std::function<void(size_t)> *work = nullptr;
    long number = 0; // of the work, since it begins
    int busy = 0;    // threads that are at work
    bool ended = false;
  };

  static void wait_for_work(std::shared_ptr<Shared> shared, size_t thread) {
    long last = 0;
    std::unique_lock hold(shared->mutex);
    while (true) {
      shared->wake.wait(hold, [&] { return shared->ended || (shared->work && shared->number != last); });
      if (shared->ended) return;
      last = shared->number;
      const auto &work = *shared->work;
      ++shared->busy;
      hold.unlock();
      work(thread);
      hold.lock();
      if (--shared->busy == 0) shared->done.notify_all();
    }
  }

  const std::shared_ptr<Shared> shared_ = std::make_shared<Shared>();
  size_t started_ = 0;
};

} // namespace pinconsist
