// Derivatives of recorded runs, in public coordinates, solved without the interpreter lock.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/function.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <optional>
#include <tuple>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/contact_results.hpp"
#include "bindings/expose.hpp"
#include "bindings/kept_contact_steps.hpp"
#include "bindings/obstacle.hpp"
#include "bindings/parameter_results.hpp"
#include "bindings/user_calls.hpp"
#include "model/coordinates.hpp"
#include "sensitivity/run_adjoint.hpp"
#include "sensitivity/run_hessian.hpp"
#include "sensitivity/run_tangent.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

template <class T>
T get(const Dict& d, const char* name) {
  return nb::cast<T>(d[name]);
}

int guard_number(const Scene& s, int kind, int index) {
  if (kind == static_cast<int>(GuardKind::kContact)) return index;
  for (std::size_t k = 0; k < s.tree.limits.size(); ++k)
    if (2 * s.tree.limits[k].source_joint + (s.tree.limits[k].upper ? 1 : 0) == index)
      return static_cast<int>(s.pairs.size() + k);
  throw Error("there is no such limit");
}

// A recorded run, which keeps its scene alive.
class Recorded {
 public:
  Recorded(const Scene& scene, const Dict& settings, const Dict& segments, const std::optional<Dict>& events,
           const std::optional<Rows>& tau, const std::optional<Rows>& target, const VecX& q_end, const VecX& p_end,
           const std::vector<const KeptContactSteps*>& contact_steps)
      : scene_(scene) {
    RecordedRun& run = run_;
    run.t0 = get<double>(settings, "t0");
    run.dt = get<double>(settings, "dt");
    run.stages = get<int>(settings, "order") / 2;
    run.tol = get<double>(settings, "tol");
    run.map = get<ImpactMap>(settings, "impact");
    run.mhc_reference = get<MhcReference>(settings, "mhc_reference");
    run.contact_points = get<int>(settings, "contact_points");
    if (run.stages < 1 || run.stages > kMaxStages || !(run.dt > 0.0)) throw Error("order or dt out of range");
    if (tau) run.tau = *tau;
    if (target) run.target = *target;
    run.q_end = q_end;
    run.p_end = p_end;
    public_to_engine(scene.tree, run.q_end, run.p_end);
    if (events) add_impacts(*events);
    add_pieces(segments);
    add_contact_steps(contact_steps);
    add_blocks(contact_steps);
  }

  Dict tangent(const Dict& directions, const std::vector<double>& times, bool take_branch) {
    const int n = scene_.tree.nv, guards = scene_.guard_count();
    RunDirections d;
    d.count = get<int>(directions, "count");
    if (d.count < 1) throw Error("directions: expected at least one column");
    const auto take = [&](const char* name, int rows, MatX& to) {
      if (!directions.contains(name)) return;
      to = get<Rows>(directions, name);
      if (to.rows() != rows || to.cols() != d.count) throw Error("directions: wrong shape");
    };
    take("q", n, d.q);
    take("v", n, d.v);
    take("tau", n, d.tau);
    if (directions.contains("inputs")) {
      d.inputs = get<Rows>(directions, "inputs");
      if (d.inputs.cols() != n || d.count != 1) throw Error("directions: wrong shape");
      for (const Piece& piece : run_.pieces)
        if (piece.step >= d.inputs.rows()) throw Error("steps: fewer than those of the run");
    }
    take("e", guards, d.e);
    take("mu", guards, d.mu);
    if (directions.contains("parameters"))
      for (nb::handle column : nb::cast<nb::list>(directions["parameters"]))
        d.parameters.push_back(parameter_direction(scene_.tree, nb::cast<nb::dict>(column)));
    if (!d.parameters.empty() && static_cast<Eigen::Index>(d.parameters.size()) != d.count)
      throw Error("parameters: expected one direction per column");
    RunDerivative found;
    try {
      const nb::gil_scoped_release release;  // functions of the user take the lock for their calls
      check_start();
      RunTangent tangent(scene_, run_, take_branch);
      found = tangent.solve(d, times);
    } catch (const NoDerivative& reason) {
      UserErrors::raise();
      return obstacle_of(scene_, reason);
    }
    UserErrors::raise();
    Dict result;
    std::vector<Rows> nodes(found.nodes.begin(), found.nodes.end());
    result["times"] = found.times;
    result["nodes"] = nodes;
    result["event_times"] = Rows(found.event_times);
    std::vector<int> first;
    std::vector<double> approach, margin;
    std::vector<int> count;
    for (const EventReport& event : found.events) {
      first.push_back(event.impact);
      approach.push_back(event.approach);
      margin.push_back(event.margin);
      count.push_back(event.guards);
    }
    result["impact"] = first;
    result["approach"] = approach;
    result["margin"] = margin;
    result["guards"] = count;
    result["growth"] = found.growth;
    std::vector<double> time, error, near;
    std::vector<std::string> why;
    for (const DenseStepReport& step : found.dense) {
      time.push_back(step.time);
      error.push_back(step.error);
      near.push_back(step.margin);
      why.emplace_back(step.why);
    }
    result["dense_time"] = time;
    result["dense_error"] = error;
    result["dense_margin"] = near;
    result["dense_why"] = why;
    std::vector<Dict> kinks;
    for (const Obstacle& at : found.kinks) kinks.push_back(place_of(scene_, at));
    result["kinks"] = kinks;
    return result;
  }

  // The gradient and the second derivative along a direction, of a cost with gradients at nodes; hessian(dq, dv)
  // returns its second derivatives along changes of the states there.
  Dict hessian(const std::vector<double>& times, const Rows& lq, const Rows& lv, const Dict& direction,
               const std::function<std::pair<Rows, Rows>(const Rows&, const Rows&)>& hessian) {
    const int n = scene_.tree.nv;
    RunVector w{get<VecX>(direction, "q"), get<VecX>(direction, "v"), get<Rows>(direction, "tau")};
    const long steps = w.tau.rows();
    if (w.q.size() != n || w.v.size() != n || w.tau.cols() != n) throw Error("direction: wrong shape");
    if (lq.rows() != static_cast<Eigen::Index>(times.size()) || lv.rows() != lq.rows() || lq.cols() != n ||
        lv.cols() != n)
      throw Error("gradients: expected shape (nodes, nv)");
    for (const Piece& piece : run_.pieces)
      if (piece.step >= steps) throw Error("steps: fewer than those of the run");
    const auto call = [&](const MatX& dq, const MatX& dv, MatX& hq, MatX& hv) {
      const auto found = hessian(dq, dv);
      hq = found.first;
      hv = found.second;
      if (hq.rows() != dq.rows() || hv.rows() != dq.rows() || hq.cols() != n || hv.cols() != n)
        throw Error("second derivatives of the cost: expected shape (nodes, nv)");
    };
    std::optional<RunCurvature> found;
    try {
      const nb::gil_scoped_release release;  // the function of the cost takes the lock, too
      check_start();
      RunHessian second(scene_, run_);
      found = second.solve({times, lq, lv, VecX()}, call, w);
    } catch (const NoDerivative& reason) {
      UserErrors::raise();
      return obstacle_of(scene_, reason);
    }
    UserErrors::raise();
    const auto dict = [&](const RunVector& l) {
      Dict d;
      Rows tau = Rows::Zero(steps, n);
      tau.topRows(l.tau.rows()) = l.tau;
      d["q"] = l.q;
      d["v"] = l.v;
      d["tau"] = tau;
      return d;
    };
    Dict result;
    result["gradient"] = dict(found->gradient);
    result["product"] = dict(found->product);
    return result;
  }

  // Gradients in the start, inputs and parameters from those at nodes and in the times of events.
  Dict adjoint(const std::vector<double>& times, const Rows& lq, const Rows& lv, const VecX& events, long steps,
               bool take_branch) {
    const int n = scene_.tree.nv;
    const Eigen::Index nodes = static_cast<Eigen::Index>(times.size());
    if (lq.rows() != nodes || lv.rows() != nodes || lq.cols() != n || lv.cols() != n)
      throw Error("gradients: expected shape (nodes, nv)");
    for (const Piece& piece : run_.pieces)
      if (piece.step >= steps) throw Error("steps: fewer than those of the run");
    std::optional<RunGradient> found;
    try {
      const nb::gil_scoped_release release;
      check_start();
      RunAdjoint adjoint(scene_, run_, take_branch);
      found = adjoint.solve({times, lq, lv, events}, steps);
    } catch (const NoDerivative& reason) {
      UserErrors::raise();
      return obstacle_of(scene_, reason);
    }
    UserErrors::raise();
    Dict d;
    d["q"] = found->q;
    d["v"] = found->v;
    d["tau"] = Rows(found->tau);
    d["q_ref"] = Rows(found->q_ref);
    d["v_ref"] = Rows(found->v_ref);
    d["e"] = found->e;
    d["mu"] = found->mu;
    d["parameters"] = parameters_of(scene_.tree, found->parameters);
    return d;
  }

  // (kind, index) of all guards, in the order of the rows of e and mu.
  Rows guards() const {
    Rows found(scene_.guard_count(), 2);
    for (int g = 0; g < scene_.guard_count(); ++g) {
      const PublicGuard guard = public_guard(scene_, g);
      found.row(g) << static_cast<int>(guard.kind), guard.index;
    }
    return found;
  }

 private:
  void check_start() const {
    if (at_start_)
      throw NoDerivative({"start", run_.impacts[0].guard, run_.t0}, "The run starts with an impact",
                         "a start where nothing hits", "an impact at the first instant", "Start a little earlier");
  }

  void add_impacts(const Dict& e) {
    const auto numbers = [&](const char* name) { return get<VecX>(e, name); };
    const auto whole = [&](const char* name) { return get<Eigen::Matrix<std::int64_t, Eigen::Dynamic, 1>>(e, name); };
    const VecX time = numbers("time"), restitution = numbers("restitution"), friction = numbers("friction"),
               after = numbers("after"), impulse = numbers("impulse");
    const auto kind = whole("kind"), index = whole("index"), points = whole("points"), method = whole("method"),
               fallback = whole("fallback");
    const Rows q = get<Rows>(e, "q"), p_minus = get<Rows>(e, "p_minus"), p_plus = get<Rows>(e, "p_plus");
    for (Eigen::Index i = 0; i < time.size(); ++i) {
      RecordedImpact r{guard_number(scene_, static_cast<int>(kind[i]), static_cast<int>(index[i])),
                       time[i],
                       restitution[i],
                       friction[i],
                       after[i],
                       static_cast<int>(points[i]),
                       static_cast<ImpactMap>(method[i]),
                       static_cast<Fallback>(fallback[i]),
                       impulse[i],
                       q.row(i).transpose(),
                       p_minus.row(i).transpose(),
                       p_plus.row(i).transpose()};
      public_to_engine(scene_.tree, r.q, r.p_minus);
      public_to_engine(scene_.tree, r.q, r.p_plus);
      run_.impacts.push_back(std::move(r));
    }
  }

  // The step that ends at t or contains it.
  long step_before(double t) const {
    return std::max(0L, static_cast<long>(std::ceil((t - run_.t0) / run_.dt - kSameTime)) - 1);
  }

  void add_pieces(const Dict& s) {
    const VecX t = get<VecX>(s, "t"), h = get<VecX>(s, "h"), persistent = get<VecX>(s, "persistent");
    const Rows q = get<Rows>(s, "q"), p = get<Rows>(s, "p"), rates = get<Rows>(s, "rates");
    const int n = scene_.tree.nv, stages = run_.stages;
    if (rates.cols() != n * stages) throw Error("rates: wrong shape");
    std::size_t impact = 0;
    const long last_step = t.size() == 0 ? 0 : step_before(t[t.size() - 1] + h[t.size() - 1]);
    at_start_ = t.size() > 0 && !run_.impacts.empty() && run_.impacts[0].time <= t[0];
    for (Eigen::Index i = 0; i < t.size(); ++i) {
      Piece piece;
      piece.t = t[i];
      piece.h = h[i];
      piece.q = q.row(i).transpose();
      piece.p = p.row(i).transpose();
      MatX rate(n, stages);
      for (int k = 0; k < stages; ++k) rate.col(k) = rates.row(i).segment(k * n, n).transpose();
      piece.velocities = stage_velocities(scene_.tree, rate, h[i]);
      piece.persistent = persistent[i] != 0.0;
      // What is left after an impact in the last instant of the run begins at its end, to rounding.
      piece.step = std::min(last_step, static_cast<long>(std::floor((t[i] - run_.t0) / run_.dt + kSameTime)));
      const double end = t[i] + h[i], rounding = 1e-15 * std::abs(end);
      piece.first_impact = static_cast<int>(impact);
      while (impact < run_.impacts.size() && run_.impacts[impact].time <= end + rounding) ++impact;
      piece.impacts = static_cast<int>(impact) - piece.first_impact;
      const double node = run_.t0 + static_cast<double>(piece.step + 1) * run_.dt;
      piece.end = piece.impacts > 0                             ? PieceEnd::kEvent
                  : std::abs(end - node) <= kSameTime * run_.dt ? PieceEnd::kTime
                                                                : PieceEnd::kLength;
      if (piece.step < 0 || (run_.tau.rows() > 0 && piece.step >= run_.tau.rows()) ||
          (run_.target.rows() > 0 && piece.step >= run_.target.rows()))
        throw Error("the inputs do not cover the run");
      run_.pieces.push_back(std::move(piece));
    }
  }

  // A run that was taken back has steps that are not part of it: the last one with the time of a piece is.
  void add_contact_steps(const std::vector<const KeptContactSteps*>& kept) {
    std::map<double, const ContactStepRecord*> at;
    std::map<double, const DenseStepRecord*> dense;
    std::map<double, const HeldStepRecord*> held;
    for (const KeptContactSteps* block : kept) {
      for (const ContactStepRecord& step : block->steps) at[step.t] = &step;
      for (const DenseStepRecord& step : block->dense) dense[step.t] = &step;
      for (const HeldStepRecord& step : block->held) held[step.t] = &step;
    }
    for (Piece& piece : run_.pieces) {
      if (const auto step = held.find(piece.t); step != held.end() && step->second->h == piece.h) {
        piece.held = step->second;
        if (piece.held->rates.cols() != run_.stages) throw Error("rates: wrong shape");
        if (piece.held->ending == HeldStepEnd::kRest) piece.end = PieceEnd::kEvent;
        continue;
      }
      if (!piece.persistent) {
        piece.persistent = scene_.tree.elements.constraint_rows > 0;  // it was not kept
        continue;
      }
      const auto step = dense.find(piece.t);
      if (step != dense.end() && step->second->h == piece.h) {
        piece.dense = step->second;
        piece.end = PieceEnd::kLength;
        continue;
      }
      const auto found = at.find(piece.t);
      if (found == at.end() || found->second->h != piece.h) continue;
      piece.contact = found->second;
      const bool at_end = piece.contact->ending != ContactStepEnd::kLength || piece.impacts > 0;
      piece.end = at_end ? PieceEnd::kEvent : PieceEnd::kLength;
    }
  }

  // The impacts of several points, by the first one of their records.
  void add_blocks(const std::vector<const KeptContactSteps*>& kept) {
    std::map<std::tuple<double, int, double>, const ImpactBlockRecord*> at;
    for (const KeptContactSteps* call : kept)
      for (const ImpactBlockRecord& block : call->blocks) at[{block.time, block.guard, block.impulse}] = &block;
    for (std::size_t i = 0; i < run_.impacts.size(); ++i) {
      RecordedImpact& impact = run_.impacts[i];
      const auto found = at.find({impact.time, impact.guard, impact.impulse});
      if (found == at.end() || i + found->second->impacts > run_.impacts.size()) continue;
      impact.block = found->second;
    }
  }

  const Scene& scene_;
  RecordedRun run_;
  bool at_start_ = false;
};

}  // namespace

Dict place_of(const Scene& scene, const Obstacle& at) {
  Dict d;
  const PublicGuard guard = public_guard(scene, at.guard);
  d["reason"] = std::string(at.reason);
  d["kind"] = static_cast<int>(guard.kind);
  d["index"] = guard.index;
  d["time"] = at.time;
  return d;
}

Dict obstacle_of(const Scene& scene, const NoDerivative& reason) {
  Dict d = place_of(scene, reason.where);
  d["fact"] = std::string(reason.what());
  d["expected"] = reason.expected;
  d["got"] = reason.got;
  d["remedy"] = reason.remedy;
  return d;
}

void expose_sensitivity(nb::module_& m) {
  nb::class_<Recorded>(m, "RecordedRun", "The pieces and impacts of a run, for its derivatives.")
      .def(
          nb::init<const Scene&, const Dict&, const Dict&, const std::optional<Dict>&, const std::optional<Rows>&,
                   const std::optional<Rows>&, const VecX&, const VecX&, const std::vector<const KeptContactSteps*>&>(),
          "scene"_a, "settings"_a, "segments"_a, "events"_a, "tau"_a, "target"_a, "q_end"_a, "p_end"_a,
          "contact_steps"_a, nb::keep_alive<1, 2>(), nb::keep_alive<1, 10>())
      .def_prop_ro("guards", &Recorded::guards, "Kind and index of all guards, as in events, (nguards, 2).")
      .def("tangent", &Recorded::tangent, "directions"_a, "times"_a, "take_branch"_a,
           "d(q, v) at times along directions, columns of q, v, tau (nv, count), e and mu (guards, count), or of one "
           "direction the inputs step by step (steps, nv); or the reason why there is none.")
      .def("adjoint", &Recorded::adjoint, "times"_a, "lq"_a, "lv"_a, "events"_a, "steps"_a, "take_branch"_a,
           "From gradients in (q, v) at times (nodes, nv) and in the times of events to those in the start, the inputs "
           "of all steps and the parameters; or the reason why there is none.")
      .def(
          "hessian", &Recorded::hessian, "times"_a, "lq"_a, "lv"_a, "direction"_a, "hessian"_a,
          "Gradients in q, v and tau from those at times, and their second derivatives along a direction (q, v: (nv,), "
          "tau: (steps, nv)); hessian(dq, dv) returns those of the cost at the nodes. Or the reason why there is "
          "none.");
}

}  // namespace contactvi
