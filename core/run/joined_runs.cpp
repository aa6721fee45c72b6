#include "run/joined_runs.hpp"

#include <algorithm>
#include <memory>
#include <utility>

#include "run/part_records.hpp"
#include "run/states_between.hpp"

namespace contactvi {

namespace {

// The values of a run that are sums since its start, in proportion between its nodes.
class Sums {
 public:
  // width: numbers of a node. mean: the values are means since the node before, of which the sums are made.
  Sums(const std::vector<double>& t, const std::vector<double>& values, std::size_t width, bool mean)
      : t_(&t), width_(width), known_(values.size() == width * t.size()) {
    if (!known_ || width == 0) return;
    sums_ = values;
    if (!mean) return;
    std::fill(sums_.begin(), sums_.begin() + static_cast<std::ptrdiff_t>(width), 0.0);
    for (std::size_t k = 1; k < t.size(); ++k)
      for (std::size_t i = 0; i < width; ++i)
        sums_[k * width + i] = sums_[(k - 1) * width + i] + values[k * width + i] * (t[k] - t[k - 1]);
  }

  bool known() const { return known_ && width_ > 0; }
  double at(double time, std::size_t i) const {
    const std::vector<double>& t = *t_;
    const std::size_t k = static_cast<std::size_t>(std::clamp<std::ptrdiff_t>(
        std::lower_bound(t.begin(), t.end(), time) - t.begin(), 0, static_cast<std::ptrdiff_t>(t.size()) - 1));
    if (k == 0) return sums_[i];
    const double x = std::clamp((time - t[k - 1]) / (t[k] - t[k - 1]), 0.0, 1.0), before = sums_[(k - 1) * width_ + i];
    return x == 1.0 ? sums_[k * width_ + i] : before + x * (sums_[k * width_ + i] - before);
  }

 private:
  const std::vector<double>* t_;
  std::size_t width_;
  bool known_;
  std::vector<double> sums_;
};

// Runs of parts on the way to one run.
class Joining {
 public:
  Joining(const Scene& whole, const SimulatorOptions& options, const std::vector<PartRun>& runs, std::size_t leader)
      : whole_(&whole),
        options_(&options),
        runs_(&runs),
        leader_(leader),
        q_(VecX::Zero(whole.tree.nq)),
        p_(VecX::Zero(whole.tree.nv)) {
    for (const PartRun& own : runs) {
      states_.push_back(std::make_unique<StatesBetween>(own.part->scene, options, *own.run));
      end_ = std::min(end_, own.run->recording.t.back());
    }
  }

  KeptRun run() {
    set_nodes();
    set_work();
    set_events();
    set_phases();
    set_counts();
    return std::move(found_);
  }

 private:
  struct Entry {
    double time;
    std::size_t part, row;
  };

  // Enters the state of a part at a time in q_ and p_.
  void gather(std::size_t k, double time) {
    const PartRun& own = (*runs_)[k];
    const Recording& r = own.run->recording;
    const Tree& tree = own.part->scene.tree;
    const std::size_t nq = static_cast<std::size_t>(tree.nq), nv = static_cast<std::size_t>(tree.nv);
    const std::size_t node = static_cast<std::size_t>(std::lower_bound(r.t.begin(), r.t.end(), time) - r.t.begin());
    part_q_.resize(tree.nq);
    part_p_.resize(tree.nv);
    if (node == r.t.size() || r.t[node] == time || r.segments.t.empty() || !states_[k]->state(time, part_q_, part_p_)) {
      const std::size_t at = std::min(node, r.t.size() - 1);
      part_q_ = Eigen::Map<const VecX>(r.q.data() + at * nq, tree.nq);
      part_p_ = Eigen::Map<const VecX>(r.p.data() + at * nv, tree.nv);
    }
    for (std::size_t i = 0; i < nq; ++i) q_[own.part->q[i]] = part_q_[static_cast<Eigen::Index>(i)];
    for (std::size_t i = 0; i < nv; ++i) p_[own.part->v[i]] = part_p_[static_cast<Eigen::Index>(i)];
  }

  void set_nodes() {
    Recording& to = found_.recording;
    for (double t : (*runs_)[leader_].run->recording.t)
      if (t < end_) to.t.push_back(t);
    to.t.push_back(end_);
    for (double t : to.t) {
      for (std::size_t k = 0; k < runs_->size(); ++k) gather(k, t);
      to.q.insert(to.q.end(), q_.data(), q_.data() + q_.size());
      to.p.insert(to.p.end(), p_.data(), p_.data() + p_.size());
    }
    const Recording& from = (*runs_)[leader_].run->recording;
    to.adaptive_t = from.adaptive_t;
    to.adaptive_dt = from.adaptive_dt;
  }

  void set_work() {
    constexpr std::size_t kWorks = 4;
    Recording& to = found_.recording;
    const std::size_t n = to.t.size(), rows = static_cast<std::size_t>(whole_->tree.elements.constraint_rows) +
                                              whole_->tree.followers.size();
    to.work.assign(kWorks * n, 0.0);
    to.reactions.assign(rows * n, 0.0);
    for (const PartRun& own : *runs_) {
      const Recording& from = own.run->recording;
      const std::vector<int>& numbers = own.part->reactions;
      const Sums work(from.t, from.work, kWorks, false), reactions(from.t, from.reactions, numbers.size(), true);
      for (std::size_t k = 0; k < n && work.known(); ++k)
        for (std::size_t i = 0; i < kWorks; ++i) to.work[kWorks * k + i] += work.at(to.t[k], i);
      for (std::size_t k = 1; k < n && reactions.known(); ++k)
        for (std::size_t i = 0; i < numbers.size(); ++i)
          to.reactions[rows * k + static_cast<std::size_t>(numbers[i])] =
              (reactions.at(to.t[k], i) - reactions.at(to.t[k - 1], i)) / (to.t[k] - to.t[k - 1]);
    }
  }

  // Calls put(entry) for what all parts have recorded of a kind up to the end, in the order of time.
  template <class Count, class Time, class Put>
  void merge(Count count, Time time, Put put) {
    std::vector<Entry> entries;
    for (std::size_t k = 0; k < runs_->size(); ++k) {
      const Recording& r = (*runs_)[k].run->recording;
      for (std::size_t row = 0; row < count(r); ++row)
        if (time(r, row) <= end_) entries.push_back({time(r, row), k, row});
    }
    std::stable_sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.time < b.time; });
    for (const Entry& entry : entries) put(*(*runs_)[entry.part].part, (*runs_)[entry.part].run->recording, entry);
  }

  void set_events() {
    Recording& to = found_.recording;
    merge([](const Recording& r) { return r.impacts.size(); },
          [](const Recording& r, std::size_t i) { return r.impacts[i].time; },
          [&](const SubScene& part, const Recording& r, const Entry& entry) {
            for (std::size_t k = 0; k < runs_->size(); ++k)
              if (k != entry.part) gather(k, entry.time);
            append_impact(part, r.impacts[entry.row], q_, p_, to.impacts);
          });
    merge([](const Recording& r) { return r.contacts.size(); },
          [](const Recording& r, std::size_t i) { return r.contacts[i].t; },
          [&](const SubScene& part, const Recording& r, const Entry& entry) {
            append_contact(part, r.contacts[entry.row], to.contacts);
          });
    merge([](const Recording& r) { return r.changes.size(); },
          [](const Recording& r, std::size_t i) { return r.changes[i].time; },
          [&](const SubScene& part, const Recording& r, const Entry& entry) {
            append_change(part, r.changes[entry.row], to.changes);
          });
    merge([](const Recording& r) { return r.dense.size(); },
          [](const Recording& r, std::size_t i) { return r.dense[i].time; },
          [&](const SubScene& part, const Recording& r, const Entry& entry) {
            append_dense(part, r.dense[entry.row], to.dense);
          });
  }

  // The kind of the steps is at all times the highest one of a part.
  void set_phases() {
    struct Now {
      int kind;
      double dt;
    };
    const int free = static_cast<int>(StepKind::kFree);
    std::vector<Now> now(runs_->size(), {free, options_->dt});
    merge([](const Recording& r) { return r.phase_t.size(); },
          [](const Recording& r, std::size_t i) { return r.phase_t[i]; },
          [&](const SubScene&, const Recording& r, const Entry& entry) {
            now[entry.part] = {r.phase_kind[entry.row], r.phase_dt[entry.row]};
            const auto highest =
                std::max_element(now.begin(), now.end(), [](const Now& a, const Now& b) { return a.kind < b.kind; });
            Recording& to = found_.recording;
            if (!to.phase_t.empty() && to.phase_t.back() == entry.time) {  // several at one time
              to.phase_kind.back() = highest->kind;
              to.phase_dt.back() = highest->dt;
            } else {
              to.enter_phase(entry.time, highest->dt, static_cast<StepKind>(highest->kind), options_->dt);
            }
          });
  }

  void set_counts() {
    RunState& to = found_.state;
    for (const PartRun& own : *runs_) {
      const RunState& from = own.run->state;
      to.step += from.step;
      to.rejected += from.rejected;
      to.dense_steps += from.dense_steps;
      add_counts(from, to);
      sum_up(own.run->counters, found_.counters);
      found_.seconds += own.run->seconds;
    }
    found_.status = (*runs_)[leader_].run->status;
    found_.status.time = end_;
  }

  const Scene* whole_;
  const SimulatorOptions* options_;
  const std::vector<PartRun>* runs_;
  std::size_t leader_;  // the part with the nodes
  std::vector<std::unique_ptr<StatesBetween>> states_;
  double end_ = kInfinity;
  VecX q_, p_, part_q_, part_p_;
  KeptRun found_;
};

}  // namespace

KeptRun joined(const Scene& whole, const SimulatorOptions& options, const std::vector<PartRun>& runs,
               std::size_t leader) {
  return Joining(whole, options, runs, leader).run();
}

}  // namespace contactvi
