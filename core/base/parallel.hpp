// Independent pieces of work side by side.
#pragma once

#include <algorithm>
#include <atomic>
#include <exception>
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

// Calls work(i) for all i in [0, count), on so many threads, the caller's among them; by default as many as the machine
// has processors. Each call writes only what is its own, so that results are the same for any number of threads. Throws
// the exception of the least i that threw.
template <class Work>
void in_parallel(int count, const Work& work,
                 int most = std::max(1, static_cast<int>(std::thread::hardware_concurrency()))) {
  std::vector<std::exception_ptr> thrown(count);
  std::atomic<int> next{0};
  const auto run = [&] {
    for (int i = next++; i < count; i = next++) {
      try {
        work(i);
      } catch (...) {
        thrown[i] = std::current_exception();
      }
    }
  };
  const int helpers = std::min(count, most) - 1;
  std::vector<std::thread> threads = start_threads(helpers, run);
  run();
  for (std::thread& thread : threads) thread.join();
  for (const std::exception_ptr& error : thrown)
    if (error) std::rethrow_exception(error);
}

}  // namespace contactvi
