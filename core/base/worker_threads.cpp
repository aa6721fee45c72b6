#include "base/worker_threads.hpp"

#include <unistd.h>

#include "base/parallel.hpp"

namespace contactvi {

WorkerThreads::WorkerThreads(int helpers) : process_(getpid()) {
  threads_ = start_threads(helpers, [this] { help(); });
}

WorkerThreads::~WorkerThreads() {
  if (getpid() != process_) {
    for (std::thread& thread : threads_) thread.detach();
    return;
  }
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    ends_ = true;
  }
  came_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

// False: none is left.
bool WorkerThreads::take_one(Call& call) {
  const int i = call.next++;
  if (i >= call.count) return false;
  try {
    (*call.work)(i);
  } catch (...) {
    call.thrown[static_cast<std::size_t>(i)] = std::current_exception();
  }
  ++call.done;
  return true;
}

void WorkerThreads::help() {
  for (long seen = 0;;) {
    std::shared_ptr<Call> call;
    {
      std::unique_lock<std::mutex> lock(mutex_);
      came_.wait(lock, [&] { return ends_ || calls_ != seen; });
      if (ends_) return;
      seen = calls_;
      call = call_;
    }
    while (call && take_one(*call)) {
    }
    const std::lock_guard<std::mutex> lock(mutex_);  // so that the caller, who looks before it waits, misses nothing
    finished_.notify_one();
  }
}

void WorkerThreads::run(int count, const std::function<void(int)>& work) {
  const auto call = std::make_shared<Call>();
  call->work = &work;
  call->count = count;
  call->thrown.resize(static_cast<std::size_t>(count));
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    call_ = call;
    ++calls_;
  }
  came_.notify_all();
  while (take_one(*call)) {
  }
  {
    std::unique_lock<std::mutex> lock(mutex_);
    finished_.wait(lock, [&] { return call->done == count; });
    call_.reset();
  }
  for (const std::exception_ptr& error : call->thrown)
    if (error) std::rethrow_exception(error);
}

}  // namespace contactvi
