// Independent pieces of work side by side.
#pragma once

#include <algorithm>
#include <atomic>
#include <exception>
#include <system_error>
#include <thread>
#include <vector>

namespace contactvi {

// Calls work(i) for all i in [0, count), on as many threads as the machine has processors. Each call writes only what
// is its own, so that results are the same for any number of threads. Throws the exception of the least i that threw.
template <class Work>
void in_parallel(int count, const Work& work) {
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
  const int helpers = std::min<int>(count, static_cast<int>(std::thread::hardware_concurrency())) - 1;
  std::vector<std::thread> threads;
  try {
    for (int k = 0; k < helpers; ++k) threads.emplace_back(run);
  } catch (const std::system_error&) {
    // The process may start no more threads; those there are, with this one, do all of the work.
  }
  run();
  for (std::thread& thread : threads) thread.join();
  for (const std::exception_ptr& error : thrown)
    if (error) std::rethrow_exception(error);
}

}  // namespace contactvi
