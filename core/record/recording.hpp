// The record of a run: nodes, impacts, contact forces, the polynomials of its steps. Engine coordinates.
#pragma once

#include <cstdint>
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
struct ContactRows {
  std::vector<double> t, h, gap, work;                                             // work: of friction in the step [J]
  std::vector<double> position, normal, position_impulse, velocity_impulse, slip;  // three numbers a row
  std::vector<int> guard, mode, dense;  // mode: ContactMode; dense: 1 for a row of a dense step, else 0
  std::vector<std::int64_t> point;
  std::vector<long> step;

  void push(double time, double length, int guard_number, std::int64_t feature, ContactMode contact_mode,
            long step_number, const Vec3& x, const Vec3& n, const Vec3& first, const Vec3& second, double phi,
            const Vec3& velocity, double friction_work = 0.0) {
    t.push_back(time);
    h.push_back(length);
    guard.push_back(guard_number);
    point.push_back(feature);
    mode.push_back(static_cast<int>(contact_mode));
    dense.push_back(0);
    step.push_back(step_number);
    gap.push_back(phi);
    work.push_back(friction_work);
    for (auto [list, value] : {std::pair(&position, &x), std::pair(&normal, &n), std::pair(&position_impulse, &first),
                               std::pair(&velocity_impulse, &second), std::pair(&slip, &velocity)})
      list->insert(list->end(), value->data(), value->data() + 3);
  }
  void cut(std::size_t rows) {
    for (auto* list : {&t, &h, &gap, &work}) list->resize(rows);
    for (auto* list : {&position, &normal, &position_impulse, &velocity_impulse, &slip}) list->resize(3 * rows);
    for (auto* list : {&guard, &mode, &dense}) list->resize(rows);
    point.resize(rows);
    step.resize(rows);
  }
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
  ContactRows contacts;
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
  // Forgets impacts, contacts, changes, dense steps and phases, and keeps their memory.
  void clear() {
    impacts.clear();
    if (!contacts.t.empty()) contacts.cut(0);
    changes.clear();
    dense.clear();
    phase_t.clear();
    phase_dt.clear();
    phase_kind.clear();
  }
  // Whether there are impacts, contacts, changes or dense steps.
  bool any_entry() const { return !(impacts.empty() && contacts.t.empty() && changes.empty() && dense.empty()); }
  // Forgets everything, and keeps its memory.
  void restart() {
    cut({0, 0, 0, 0, 0, 0, 0});
    adaptive_t.clear();
    adaptive_dt.clear();
  }
  // The amount recorded so far, to which cut() returns.
  struct Mark {
    std::size_t nodes, impacts, segments, contacts, changes, phases, dense;
  };
  Mark mark() const {
    return {t.size(),       impacts.size(), segments.t.size(), contacts.t.size(),
            changes.size(), phase_t.size(), dense.size()};
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
    contacts.cut(mark.contacts);
    changes.resize(mark.changes);
    phase_t.resize(mark.phases);
    phase_dt.resize(mark.phases);
    phase_kind.resize(mark.phases);
    dense.resize(mark.dense);
  }
};

}  // namespace contactvi
