// Threads that stay, for pieces of work that come often and are short.
#pragma once

#include <atomic>
#include <condition_variable>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace contactvi {

class WorkerThreads {
 public:
  // So many besides the one that calls run(), or as many as the process may start.
  explicit WorkerThreads(int helpers);
  ~WorkerThreads();
  WorkerThreads(const WorkerThreads&) = delete;
  WorkerThreads& operator=(const WorkerThreads&) = delete;

  // Calls work(i) for all i in [0, count), each in one of the threads, and returns when all have returned. The pieces
  // are taken in their order; each writes only what is its own. Throws the exception of the least i that threw. What
  // the helpers do not take the caller does: they may be gone, as in a process that was forked.
  void run(int count, const std::function<void(int)>& work);

 private:
  // The pieces of one call. Helpers that come late find none left, and keep it alive until they have seen that.
  struct Call {
    const std::function<void(int)>* work;
    int count;
    std::atomic<int> next{0}, done{0};
    std::vector<std::exception_ptr> thrown;
  };
  void help();
  static bool take_one(Call& call);

  std::vector<std::thread> threads_;
  std::mutex mutex_;
  std::condition_variable came_, finished_;
  std::shared_ptr<Call> call_;
  long calls_ = 0;
  bool ends_ = false;
  int process_;  // in which the threads are
};

}  // namespace contactvi
