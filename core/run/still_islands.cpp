#include "run/still_islands.hpp"

#include "run/part_records.hpp"

namespace contactvi {

void StillIslands::set(std::vector<Island*> islands) {
  islands_ = std::move(islands);
  constrained_.clear();
  dense_.clear();
  kind_ = StepKind::kFree;
  rows_ = std::make_shared<StillRows>();
  for (Island* island : islands_) {
    const Recording& last = island->recording();
    const SubScene& numbers = island->numbers();
    for (const ContactRow& row : last.contacts) append_contact(numbers, row, rows_->rows);
    for (const DenseRecord& row : last.dense) append_dense(numbers, row, dense_);
    for (std::size_t k = 0; k < last.phase_kind.size(); ++k) {
      if (last.phase_kind[k] <= static_cast<int>(kind_)) continue;
      kind_ = static_cast<StepKind>(last.phase_kind[k]);
      kind_dt_ = last.phase_dt[k];
    }
    if (island->mean_reactions().size() > 0) constrained_.push_back(island);
  }
}

void StillIslands::record(long step, double start_time, double dt, double t, double length,
                          Recording& recording) const {
  for (DenseRecord row : dense_) {
    row.time = t;
    row.step = step;
    recording.dense.push_back(row);
  }
  if (!rows_ || rows_->rows.empty()) return;
  if (!recording.still.empty()) {
    StillContacts& last = recording.still.back();
    if (last.rows == rows_ && last.first + last.count == step && last.length == length) {
      ++last.count;
      return;
    }
  }
  recording.still.push_back({rows_, step, 1, start_time, dt, length});
}

void StillIslands::add_reactions(double length, WorkAccount& work) const {
  for (Island* island : constrained_) {
    WorkAccount::FreeWork done;
    done.reactions = length * island->mean_reactions();
    work.add(done, island->numbers().reactions);
  }
}

}  // namespace contactvi
