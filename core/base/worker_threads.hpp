// Independent pieces of work side by side.
#pragma once

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace contactvi {

// Starts so many threads that call work(), or as many as the process may start.
template <class Work>
std::vector<std::thread> start_threads(int count, const Work& work) {
  std::vector<std::thread> threads;
  try {
    for (int k = 0; k < count; ++k) threads.emplace_back(work);
  } catch (const std::system_error&) {
    // It may start no more of them.
  }
  return threads;
}

// Threads that stay, for pieces of work that come often and are short.
class WorkerThreads {
 public:
  // So many besides the one that calls run(), or as many as the process may start.
  explicit WorkerThreads(int helpers);
  ~WorkerThreads();
  WorkerThreads(const WorkerThreads&) = delete;
  WorkerThreads& operator=(const WorkerThreads&) = delete;

  // Calls work(i) for all i in [0, count), each in one of the threads, and returns when all have returned. The pieces
  // are taken in their order; each writes only what is its own, so that results are the same for any number of threads.
  // Throws the exception of the least i that threw. In a process that was forked, where the helpers are not, the caller
  // does all of them.
  void run(int count, const std::function<void(int)>& work);

  // Whether the thread in which this is called is a helper of some WorkerThreads.
  static bool in_helper();

 private:
  // The pieces of one call. Helpers that come late find none left, and keep it alive until they have seen that.
  struct Call {
    const std::function<void(int)>* work;
    int count;
    std::atomic<int> next{0}, done{0};
    std::vector<std::exception_ptr> thrown;
  };
  struct Shared {
    std::mutex mutex;
    std::condition_variable came, finished;
    std::shared_ptr<Call> call;
    long calls = 0;
    bool ends = false;
  };
  static void help(Shared& shared);
  static bool take_one(Call& call);
  bool has_helpers() const;

  std::unique_ptr<Shared> shared_;
  std::vector<std::thread> threads_;
  int process_;  // in which the threads are
};

// The same with threads for this call alone; by default as many as the machine has processors.
template <class Work>
void in_parallel(int count, const Work& work,
                 int most = std::max(1, static_cast<int>(std::thread::hardware_concurrency()))) {
  WorkerThreads(std::min(count, most) - 1).run(count, work);
}

}  // namespace contactvi
