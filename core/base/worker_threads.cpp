#include "base/worker_threads.hpp"

#include <unistd.h>

namespace contactvi {

namespace {
thread_local bool is_helper = false;
}

WorkerThreads::WorkerThreads(int helpers) : shared_(std::make_unique<Shared>()), process_(getpid()) {
  threads_ = start_threads(helpers, [&shared = *shared_] { help(shared); });
}

bool WorkerThreads::in_helper() { return is_helper; }

bool WorkerThreads::has_helpers() const { return !threads_.empty() && getpid() == process_; }

WorkerThreads::~WorkerThreads() {
  if (!threads_.empty() && !has_helpers()) {
    // What the threads of the other process waited for when this one was forked would wait for them to leave it.
    for (std::thread& thread : threads_) thread.detach();
    static_cast<void>(shared_.release());
    return;
  }
  {
    const std::lock_guard<std::mutex> lock(shared_->mutex);
    shared_->ends = true;
  }
  shared_->came.notify_all();
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

void WorkerThreads::help(Shared& shared) {
  is_helper = true;
  for (long seen = 0;;) {
    std::shared_ptr<Call> call;
    {
      std::unique_lock<std::mutex> lock(shared.mutex);
      shared.came.wait(lock, [&] { return shared.ends || shared.calls != seen; });
      if (shared.ends) return;
      seen = shared.calls;
      call = shared.call;
    }
    while (call && take_one(*call)) {
    }
    // Locked so that the caller, who looks before it waits, misses nothing.
    const std::lock_guard<std::mutex> lock(shared.mutex);
    shared.finished.notify_one();
  }
}

void WorkerThreads::run(int count, const std::function<void(int)>& work) {
  const auto call = std::make_shared<Call>();
  call->work = &work;
  call->count = count;
  call->thrown.resize(static_cast<std::size_t>(count));
  const bool helped = has_helpers();
  if (helped) {
    {
      const std::lock_guard<std::mutex> lock(shared_->mutex);
      shared_->call = call;
      ++shared_->calls;
    }
    shared_->came.notify_all();
  }
  while (take_one(*call)) {
  }
  if (helped) {
    std::unique_lock<std::mutex> lock(shared_->mutex);
    shared_->finished.wait(lock, [&] { return call->done == count; });
    shared_->call.reset();
  }
  for (const std::exception_ptr& error : call->thrown)
    if (error) std::rethrow_exception(error);
}

}  // namespace contactvi
