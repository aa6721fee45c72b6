#include "simulator.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "energy.hpp"
#include "impact_ctec.hpp"
#include "impact_dtec.hpp"
#include "impact_mhc.hpp"

namespace contactvi {

namespace {
constexpr double kZenoFlight = 0.05;    // of a step: e times the last flight below it ends the bouncing
constexpr double kShortFlight = 0.02;   // of the longest flight: what a step counts for there at most
constexpr int kZenoFlights = 4;         // flights in a row, each shorter than the one before
constexpr double kSeparated = 1e-13;    // of the event's speeds: closing slower than this is rounding
constexpr double kPlasticSpeed = 1e-9;  // of the event's speeds: an endless sequence is cut here, e = 0
constexpr double kShortest = 1e-6;      // of a step: halving ends there,
constexpr int kMostHalvings = 4000;     // and after so many in one step
constexpr int kEasySteps = 4;           // short steps in a row before a longer one is tried
constexpr int kCtec = 0, kDtec = 1, kMhc = 2;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
}  // namespace

Simulator::Simulator(const Scene& scene, const SimulatorOptions& options)
    : scene_(&scene),
      options_(options),
      integrator_(scene.tree, options.stages, options.tol, options.max_iterations),
      guards_(scene),
      finder_(scene, integrator_, guards_),
      path_(scene.tree, options.stages),
      q_(VecX::Zero(scene.tree.nq)),
      p_(VecX::Zero(scene.tree.nv)),
      q1_(scene.tree.nq),
      p1_(scene.tree.nv),
      v_(scene.tree.nv),
      rates_(scene.tree.nv, options.stages),
      bouncing_(scene.guard_count()) {
  if (options.impact < kCtec || options.impact > kMhc) throw Error("unknown impact map");
}

bool Simulator::end(StatusCode code, double time, std::string message, int guard) {
  status_ = {code, std::move(message), time, guard, kNaN, kNaN};
  return false;
}

Status Simulator::reset(const VecX& q, const VecX& v, double t) {
  status_ = {StatusCode::kSuccess, "", t, -1, kNaN, kNaN};
  q_ = q;
  v_ = v;
  t0_ = time_ = t;
  step_ = impacts_ = halved_ = rejected_ = 0;
  speed_scale_ = 0.0;
  target_step_ = -1;
  trial_ = options_.dt;
  easy_ = 0;
  arc_h_ = options_.dt;
  integrator_.counters = StepCounters();
  integrator_.forget();
  guards_.counters = GuardCounters();
  guards_.unmark_all();
  bouncing_.assign(bouncing_.size(), Bouncing());
  if (!q.allFinite() || !v.allFinite()) {
    end(StatusCode::kNotFinite, t, "the start state is not finite");
    return status_;
  }
  integrator_.dynamics(q_, v_, p_, p1_);
  if (options_.impact == kMhc) target_ = modified_hamiltonian(integrator_, q_, p_, options_.dt);
  guards_.place(q_);
  for (int g = 0; g < guards_.count(); ++g) {
    Contact contact;
    const double gap = guards_.evaluate(g, contact), tolerance = guards_.touch_tolerance(g);
    finder_.set_touching(g, gap <= tolerance);
    if (!(gap >= -tolerance)) {
      end(StatusCode::kPenetration, t, "the start state is in penetration", g);
      status_.depth = -gap;
      return status_;
    }
  }
  return status_;
}

void Simulator::record_node(double t, Recording& recording) const {
  recording.t.push_back(t);
  recording.q.insert(recording.q.end(), q_.data(), q_.data() + q_.size());
  recording.p.insert(recording.p.end(), p_.data(), p_.data() + p_.size());
}

// The step of length h from (q_, p_) whose rates are in rates_.
void Simulator::record_segment(double t, double h, const VecX& p1, Recording& recording) {
  if (!options_.dense) return;
  Segments& s = recording.segments;
  s.t.push_back(t);
  s.h.push_back(h);
  s.q.insert(s.q.end(), q_.data(), q_.data() + q_.size());
  s.p.insert(s.p.end(), p_.data(), p_.data() + p_.size());
  s.p1.insert(s.p1.end(), p1.data(), p1.data() + p1.size());
  s.rates.insert(s.rates.end(), rates_.data(), rates_.data() + rates_.size());
}

// True unless the caller asks to stop.
bool Simulator::report(double time) {
  using Clock = std::chrono::steady_clock;
  if (!*progress_ || Clock::now() - reported_ < std::chrono::milliseconds(100)) return true;
  reported_ = Clock::now();
  return (*progress_)(time, impacts_) || end(StatusCode::kInterrupted, time, "interrupted");
}

Status Simulator::advance(long steps, const MatX& tau, long record_every, const Progress& progress,
                          Recording& recording) {
  status_ = {StatusCode::kSuccess, "", time_, -1, kNaN, kNaN};
  VecX force;
  if (recording.t.empty()) record_node(time_, recording);
  reported_ = std::chrono::steady_clock::now();
  progress_ = &progress;
  for (long k = 0; k < steps; ++k) {
    if (tau.rows() > 0) force = tau.row(k).transpose();
    if (!interval(t0_ + static_cast<double>(step_) * options_.dt, options_.dt, force, recording)) {
      // The run ends inside of a step: its last node is the state there.
      if (status_.code != StatusCode::kNotFinite && status_.time > recording.t.back())
        record_node(status_.time, recording);
      return status_;
    }
    ++step_;
    time_ = t0_ + static_cast<double>(step_) * options_.dt;
    if (step_ % record_every == 0 || k + 1 == steps) record_node(time_, recording);
    if (k % 64 == 63 && !report(time_)) return status_;
  }
  status_.time = time_;
  return status_;
}

// A step of length h did not work out: shorter from here on.
void Simulator::halve(double h) {
  trial_ = 0.5 * h;
  easy_ = 0;
  ++halved_;
}

// Smooth step of length h from (q_, p_) into (q1_, p1_); false also when it has to be tried shorter.
bool Simulator::smooth_step(double time, double h, const VecX& tau, bool last_try) {
  if (!integrator_.solve(q_, p_, h, tau)) {
    if (!last_try) return false;
    const bool finite = q_.allFinite() && p_.allFinite();
    return end(finite ? StatusCode::kNewtonFailed : StatusCode::kNotFinite, time,
               std::string("the discrete Euler-Lagrange equation was not solved: ") + integrator_.why());
  }
  truncation_ = std::max(truncation_, level_ > 0.0 ? integrator_.truncation() : 0.0);
  integrator_.finish(q1_, p1_);
  if (guards_.count() > 0 || options_.dense) rates_ = integrator_.rates();
  integrator_.accept();
  return true;
}

bool Simulator::search_failed(Search outcome, double time) {
  if (outcome == Search::kNewtonFailed)
    return end(StatusCode::kNewtonFailed, time,
               std::string("a partial step to an event was not solved: ") + integrator_.why(), finder_.failed_guard());
  end(StatusCode::kEventUnresolved, time, "a guard crossed zero and its root was not found", finder_.failed_guard());
  status_.depth = -finder_.failed_gap();
  return false;
}

// From start over length: steps as long as they can be, and what the events in them ask for.
bool Simulator::interval(double start, double length, const VecX& tau, Recording& recording) {
  double remaining = length, done = 0.0;
  const long halved = halved_;
  long pieces = 0;
  impacts_in_step_ = 0;
  set_reference();
  while (remaining > 0.0) {
    const bool shorter = trial_ < remaining * (1.0 - 1e-9);
    const double h = shorter ? trial_ : remaining;
    const bool last_try = level_ > 0.0 || h < kShortest * options_.dt || halved_ - halved >= kMostHalvings;
    if (++pieces % 64 == 0 && !report(start + done)) return false;
    if (!smooth_step(start + done, h, tau, last_try)) {
      if (last_try) return false;
      halve(h);
      continue;
    }
    Search found = Search::kNone;
    if (guards_.count() > 0) {
      path_.set(q_, h, rates_);
      found = finder_.search(q_, p_, q1_, p1_, h, tau, path_);
    }
    if ((found == Search::kNewtonFailed || found == Search::kUnresolved) && !last_try) {
      integrator_.forget();  // it had taken the step
      halve(h);
      continue;
    }
    if (shorter && ++easy_ >= kEasySteps) {
      trial_ *= 2.0;
      easy_ = 0;
    }
    if (found == Search::kNone) {
      record_segment(start + done, h, p1_, recording);
      q_.swap(q1_);
      p_.swap(p1_);
      done += h;
      remaining = shorter ? length - done : 0.0;
      if (remaining > 0.0) set_reference();  // of a step that was cut every piece counts as one
      continue;
    }
    if (found != Search::kFound) return search_failed(found, start + done);
    const double before = finder_.event().alpha * h;
    if (options_.dense && before > 0.0) rates_ = integrator_.rates();
    if (before > 0.0) record_segment(start + done, before, finder_.event().p, recording);
    integrator_.forget();
    done += before;
    remaining = finder_.event().alpha >= 1.0 && !shorter ? 0.0 : length - done;
    q_ = finder_.event().q;
    p_ = finder_.event().p;
    if (!resolve_event({start + done, before, remaining, tau}, recording)) return false;
    // An implicit map has chosen its impulse for the rest of the step in one piece.
    if (options_.impact != kCtec) trial_ = std::max(trial_, remaining);
  }
  if (!q_.allFinite() || !p_.allFinite()) return end(StatusCode::kNotFinite, start + length, "the state is not finite");
  return true;
}

// MHC's local reference is the state at the start of the step.
void Simulator::set_reference() {
  if (options_.impact != kMhc || options_.mhc_global) return;
  q_node_ = q_;
  p_node_ = p_;
  target_step_ = -1;
}

bool Simulator::resolve_event(const Instant& at, Recording& recording) {
  const bool touched = finder_.touching(finder_.event().guard);
  if (options_.impact != kCtec) target_ = energy_target(at.before);
  if (!collect_closed(at.time) || !hit_until_separate(at, recording)) return false;
  for (int i = 0; i < closed_count_; ++i) finder_.set_touching(closed_[i].guard, true);
  return judge_accumulation(at.time, touched);
}

// Value of the map's scalar before the event, losses not yet subtracted; what damping and inputs have done since the
// scalar's own instant (the middle of the partial step, or the node) is added, so that the impact does not give it
// back.
double Simulator::energy_target(double before) {
  // The integrator still holds the partial step to the event.
  const double work = before > 0.0 ? integrator_.work() : 0.0;
  if (options_.impact == kDtec) {
    if (before > 0.0) return integrator_.discrete_energy() + work - integrator_.mean_work();
    const Energy now = energy(integrator_, q_, p_);
    return now.kinetic + now.potential;
  }
  if (options_.mhc_global || target_step_ == step_) return target_ + work;
  target_step_ = step_;
  return modified_hamiltonian(integrator_, q_node_, p_node_, options_.dt) + work;
}

ImpactResult Simulator::apply_map(const ImpactProblem& problem) {
  switch (options_.impact) {
    case kDtec:
      return impact_dtec(problem, p_);
    case kMhc:
      return impact_mhc(problem, p_);
    default:
      return impact_ctec(problem, p_);
  }
}

// Contacts that are closed at the event, with their gradients and inverse inertias.
bool Simulator::collect_closed(double time) {
  closed_count_ = 0;
  guards_.place(q_);
  if (!integrator_.node_velocity(q_, p_, v_))
    return end(StatusCode::kNewtonFailed, time, "the mass matrix is not positive definite");
  for (int g : finder_.active()) {
    Contact contact;
    const double gap = guards_.evaluate(g, contact);
    if (g != finder_.event().guard && !(gap <= guards_.touch_tolerance(g))) {
      finder_.set_touching(g, false);
      continue;
    }
    if (closed_count_ == static_cast<int>(closed_.size()))
      closed_.push_back({0, contact, VecX(scene_->tree.nv), VecX(scene_->tree.nv), 0.0, false});
    Closed& c = closed_[closed_count_++];
    c.guard = g;
    c.contact = contact;
    c.hit = false;
    guards_.gradient(g, contact, c.W);
    c.MinvW = c.W;
    integrator_.solve_mass(c.MinvW);
    c.G_c = c.W.dot(c.MinvW);
  }
  return true;
}

// Single impacts, always at the contact that closes fastest, until every closed contact separates.
bool Simulator::hit_until_separate(const Instant& at, Recording& recording) {
  double scale = 0.0;
  for (int i = 0; i < closed_count_; ++i) scale = std::max(scale, std::abs(closed_[i].MinvW.dot(p_)));
  speed_scale_ = std::max(speed_scale_, scale);
  // A contact that has not separated but by rounding is not hit again by what rounding left of its speed.
  const Event& event = finder_.event();
  if ((event.persistent || finder_.touching(event.guard)) && scale <= kSeparated * speed_scale_) return true;
  for (;;) {
    Closed* worst = nullptr;
    double gamma = -kSeparated * scale;
    for (int i = 0; i < closed_count_; ++i) {
      const double candidate = closed_[i].MinvW.dot(p_);
      if (candidate < gamma) {
        gamma = candidate;
        worst = &closed_[i];
      }
    }
    if (worst == nullptr) return true;
    const double e = gamma > -kPlasticSpeed * scale ? 0.0 : scene_->restitution(worst->guard);
    if (!hit(*worst, gamma, e, at, recording)) return false;
    if (++impacts_in_step_ > options_.max_impacts_per_step)
      return end(StatusCode::kTooManyImpacts, at.time, "too many impacts in one step", worst->guard);
  }
}

// One impact at one closed contact, by the map of the run.
bool Simulator::hit(Closed& closed, double gamma, double e, const Instant& at, Recording& recording) {
  const VecX p_minus = p_;
  ImpactProblem problem{integrator_, q_, p_minus,     closed.W, closed.MinvW, gamma,
                        closed.G_c,  e,  options_.dt, at.after, at.tau,       0.0};
  target_ -= problem.loss();
  problem.target = target_;
  const ImpactResult result = apply_map(problem);
  if (!result.ok) return end(StatusCode::kNotFinite, at.time, "an impact has no finite impulse", closed.guard);
  // After a fallback the scalar is what it is: the next impact must not be made to pay the difference back.
  if (result.fallback != Fallback::kNone && !options_.mhc_global && std::isfinite(result.jump)) target_ += result.jump;
  closed.hit = true;
  ++impacts_;
  ImpactRecord record;
  record.time = at.time;
  record.guard = closed.guard;
  record.point = 0.5 * (closed.contact.point_a + closed.contact.point_b);
  record.normal = closed.contact.normal;
  record.impulse = result.impulse;
  record.gamma_minus = gamma;
  record.gamma_plus = closed.MinvW.dot(p_);
  record.G_c = closed.G_c;
  record.gap = closed.contact.gap;
  record.restitution = e;
  record.method = options_.impact;
  record.iterations = result.iterations;
  record.fallback = static_cast<int>(result.fallback);
  record.jump = result.jump;
  record.before = at.before;
  record.after = at.after;
  record.step = step_;
  record.q = q_;
  record.p_minus = p_minus;
  record.p_plus = p_;
  recording.impacts.push_back(std::move(record));
  return true;
}

// touched: the event's guard was closed before.
bool Simulator::judge_accumulation(double time, bool touched) {
  const Event& event = finder_.event();
  bool any = false;
  for (int i = 0; i < closed_count_; ++i) {
    if (!closed_[i].hit) continue;
    any = true;
    const int guard = closed_[i].guard;
    Bouncing& b = bouncing_[guard];
    const double flight = time - b.last_time;
    if (b.hits > 0 && flight > 0.0) {
      const bool shorter = b.hits > 1 && flight < b.last_flight;
      b.contracting = shorter ? b.contracting + 1 : 0;
      const double e = scene_->restitution(guard);
      b.longest_flight = std::max(b.longest_flight, flight);
      if (e < 1.0 && b.contracting >= kZenoFlights &&
          e * flight < kZenoFlight * std::min(arc_h_, kShortFlight * b.longest_flight)) {
        end(StatusCode::kZeno, time, "impacts accumulate", guard);
        // Flights shrink geometrically; their measured ratio, not e, is right for articulated bodies too.
        const double ratio = flight / b.last_flight;
        status_.accumulation_time = time + flight * ratio / (1.0 - ratio);
        return false;
      }
      b.last_flight = flight;
    }
    b.last_time = time;
    ++b.hits;
  }
  if (!any && (event.persistent || touched)) {
    end(StatusCode::kZeno, time, "a contact stays closed", event.guard);
    status_.accumulation_time = time;
    return false;
  }
  return true;
}

}  // namespace contactvi
