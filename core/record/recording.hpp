// The record of a run: nodes, impacts, contact forces, the polynomials of its steps. Engine coordinates.
#pragma once

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

struct ImpactRecord {
  double time;
  int guard;
  Vec3 point, normal;
  Vec3 impulse_vector;  // on geometry b, world frame [N s]
  double impulse, gamma_minus, gamma_plus, G_c, gap, restitution, friction;
  int points;                        // how many of the pair took part
  double loss;                       // of kinetic energy by restitution and friction [J]
  int method, iterations, fallback;  // ImpactMap, evaluations of its scalar, Fallback
  double jump;                       // residual of the map's own energy equation [J]
  double before, after;              // lengths [s] of the partial step that ends here and of the rest of the step
  long step;
  VecX q, p_minus, p_plus;
};

// Steps and partial steps between nodes and impacts, row after row: start time and length, state at the start,
// momentum at the end (before an impact), chart rates at the stages (StepPath).
struct Segments {
  std::vector<double> t, h, q, p, p1, rates;  // rates: stage by stage
  // Whether contacts persist in the step, so that its parts are not smooth steps without them. The numbers are those of
  // stored runs.
  static constexpr double kFree = 0.0, kContactStep = 1.0, kHeld = 2.0;
  std::vector<double> persistent;  // kContactStep: of order 2; kHeld: in a smooth step
};

// The numbers are those of stored runs.
enum class ContactMode : int { kSticks = 0, kSlips = 1, kFrictionless = 2, kImpact = 3 };

// Contact forces: one row per persistent contact and step, and per point of an impact (h = 0). World frame, impulses on
// geometry b.
struct ContactRow {
  double t, h;  // start and length of the step [s]
  int guard;
  std::int64_t point;
  ContactMode mode;
  long step;
  Vec3 position, normal, position_impulse, velocity_impulse;
  double gap;
  Vec3 slip;
  double work = 0.0;   // of friction in the step [J]
  bool dense = false;  // of a dense step
};

// The contacts of what lies still: the same rows in every step of a span, each from the start of its step on. In a row
// t, h and step are of no account.
struct StillRows {
  std::vector<ContactRow> rows;
};
struct StillContacts {
  std::shared_ptr<StillRows> rows;
  long first, count;              // the steps
  double start_time, dt, length;  // step k starts at start_time + k dt and is so long [s]
};

// Beginnings, ends and changes of persistent contacts. The numbers are those of stored runs.
enum class Change : int {
  kBegin = 0,
  kRelease = 1,
  kStick = 2,
  kSlip = 3,
  kBouncingEnds = 4,  // accumulating impacts became plastic; value: the time at which they would have ended [s]
  kInconsistent = 5,  // Painleve's paradox; value: A (ContactOutcome)
  kOverlap = 6,       // a pair overlaps by more than is promised, and more than any before; value: its gap [m]
};
struct ChangeRecord {
  double time;
  int guard;
  std::int64_t point;
  Change change;
  double value;
};

// The kinds of steps in Recording::phase_kind. The numbers are those of stored runs.
enum class StepKind : int { kFree = 0, kPersistent = 1, kDense = 2 };

// A dense step: how exactly its law holds, and what it took (contact/dense_step.hpp, DenseReport).
struct DenseRecord {
  double time, h, residual, gap, energy_rise, energy_loss, energy_error;
  int contacts, repaired;
  long step;
  int island;  // the first body of the island that the step belongs to
};

struct Recording {
  std::vector<double> t, q, p;  // row-major (N, nq), (N, nv)
  // Per node: work since the reset [J], four kinds (Simulator::Work); mean forces of the constraints since the node
  // before.
  std::vector<double> work, reactions;
  std::vector<ImpactRecord> impacts;
  Segments segments;
  std::vector<double> adaptive_t, adaptive_dt;  // of run_auto: start and step of each smooth piece of the motion [s]
  std::vector<ContactRow> contacts;
  std::vector<StillContacts> still;
  std::vector<ChangeRecord> changes;
  std::vector<DenseRecord> dense;
  // Where the kind or the length of the steps changes: from phase_t on steps of length phase_dt and of kind phase_kind
  // (StepKind).
  std::vector<double> phase_t, phase_dt;
  std::vector<int> phase_kind;

  // From `time` [s] on steps are of this kind and have the length dt [s]. first_dt: that of the steps before the first
  // entry, which are free.
  void enter_phase(double time, double dt, StepKind kind, double first_dt) {
    if (!phase_t.empty() && phase_kind.back() == static_cast<int>(kind) && phase_dt.back() == dt) return;
    if (phase_t.empty() && !t.empty() && t.front() < time) push_phase(t.front(), first_dt, StepKind::kFree);
    push_phase(time, dt, kind);
  }
  void push_phase(double time, double dt, StepKind kind) {
    phase_t.push_back(time);
    phase_dt.push_back(dt);
    phase_kind.push_back(static_cast<int>(kind));
  }
  // Makes room for so many more nodes, as far as that is no large part of the memory: arrays that grow are copied, and
  // their pages are new ones each time.
  void expect(long nodes, int nq, int nv) {
    constexpr std::size_t most = std::size_t{1} << 23;
    const std::size_t count = static_cast<std::size_t>(nodes);
    for (const auto& [list, each] : {std::pair(&t, 1), std::pair(&q, nq), std::pair(&p, nv)})
      if (const std::size_t more = count * static_cast<std::size_t>(each); count < most && more < most)
        list->reserve(list->size() + more);
  }
  // Forgets impacts, contacts, changes, dense steps and phases, and keeps their memory.
  void clear() {
    impacts.clear();
    contacts.clear();
    changes.clear();
    dense.clear();
    phase_t.clear();
    phase_dt.clear();
    phase_kind.clear();
  }
  // Whether there are impacts, contacts, changes or dense steps.
  bool any_entry() const { return !(impacts.empty() && contacts.empty() && changes.empty() && dense.empty()); }
  // Forgets everything, and keeps its memory.
  void restart() {
    cut({0, 0, 0, 0, 0, 0, 0});
    adaptive_t.clear();
    adaptive_dt.clear();
    still.clear();
  }
  // The amount recorded so far, to which cut() returns.
  struct Mark {
    std::size_t nodes, impacts, segments, contacts, changes, phases, dense;
  };
  Mark mark() const {
    return {t.size(), impacts.size(), segments.t.size(), contacts.size(), changes.size(), phase_t.size(), dense.size()};
  }
  void cut(const Mark& mark) {
    const std::size_t nodes = t.size() > 0 ? t.size() : 1;
    const std::size_t nq = q.size() / nodes, nv = p.size() / nodes, rows = reactions.size() / nodes;
    const std::size_t count = segments.t.size(), rates = count == 0 ? 0 : segments.rates.size() / count;
    t.resize(mark.nodes);
    q.resize(mark.nodes * nq);
    p.resize(mark.nodes * nv);
    work.resize(mark.nodes * work.size() / nodes);
    reactions.resize(mark.nodes * rows);
    impacts.resize(mark.impacts);
    segments.t.resize(mark.segments);
    segments.h.resize(mark.segments);
    segments.q.resize(mark.segments * nq);
    segments.p.resize(mark.segments * nv);
    segments.p1.resize(mark.segments * nv);
    segments.rates.resize(mark.segments * rates);
    segments.persistent.resize(mark.segments);
    contacts.resize(mark.contacts);
    changes.resize(mark.changes);
    phase_t.resize(mark.phases);
    phase_dt.resize(mark.phases);
    phase_kind.resize(mark.phases);
    dense.resize(mark.dense);
  }
};

}  // namespace contactvi
