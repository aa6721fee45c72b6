// What a run asks its caller while it goes on.
#pragma once

#include <chrono>
#include <functional>

namespace contactvi {

// Called about ten times a second with (time [s], impacts so far); false asks the run to stop.
using Progress = std::function<bool(double, long)>;

class ProgressReports {
 public:
  // A call of the run begins. The function must stay.
  void begin(const Progress& progress) {
    go_on(progress);
    last_ = Clock::now();
  }
  // The next part of one that has begun.
  void go_on(const Progress& progress) { progress_ = &progress; }
  // False: the run is to stop.
  bool ask(double time, long impacts) {
    if (!*progress_ || Clock::now() - last_ < std::chrono::milliseconds(100)) return true;
    last_ = Clock::now();
    return (*progress_)(time, impacts);
  }

 private:
  using Clock = std::chrono::steady_clock;
  const Progress* progress_ = nullptr;
  Clock::time_point last_;
};

}  // namespace contactvi
