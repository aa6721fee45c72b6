#include "run/kept_run.hpp"

#include <algorithm>

namespace contactvi {

SegmentArrays arrays_of(const Segments& s) {
  return {static_cast<Eigen::Index>(s.t.size()),
          s.t.data(),
          s.h.data(),
          s.q.data(),
          s.p.data(),
          s.p1.data(),
          s.rates.data(),
          s.persistent.data()};
}

std::vector<double> impact_times(const Recording& recording) {
  std::vector<double> times;
  times.reserve(recording.impacts.size());
  for (const ImpactRecord& impact : recording.impacts) times.push_back(impact.time);
  return times;
}

double motion_size(const Tree& tree, const KeptRun& run) {
  double size = 0.0;
  for (std::size_t k = 1; k < run.recording.t.size(); ++k)
    size = std::max(size, configuration_distance(tree, run.configuration(tree, 0), run.configuration(tree, k)));
  return size;
}

bool counts_work(const Recording& recording) {
  const auto any = [](const std::vector<double>& values) {
    return std::any_of(values.begin(), values.end(), [](double value) { return value != 0.0; });
  };
  const auto slid = [](const ContactRow& row) { return row.work != 0.0; };
  return any(recording.work) || any(recording.reactions) ||
         std::any_of(recording.contacts.begin(), recording.contacts.end(), slid);
}

double contact_time(const KeptRun& run) {
  const Segments& s = run.recording.segments;
  double sum = 0.0;
  for (std::size_t k = 0; k < s.t.size(); ++k)
    if (s.persistent[k] == Segments::kContactStep) sum += s.h[k];
  return sum;
}

}  // namespace contactvi
