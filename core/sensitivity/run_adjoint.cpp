#include "sensitivity/run_adjoint.hpp"

#include <cmath>

#include "model/coordinates.hpp"
#include "step/energy.hpp"

namespace contactvi {

RunAdjoint::RunAdjoint(const Scene& scene, const RecordedRun& run, bool take_branch)
    : scene_(&scene),
      run_(&run),
      kinks_(take_branch),
      integrator_(scene.tree, run.stages, run.tol, 200),
      tangent_(scene.tree, run.stages),
      adjoint_(scene.tree, run.stages),
      inputs_(scene.tree, run),
      impact_(scene, run, kinks_),
      contact_(scene, run, kinks_),
      lq0_(scene.tree.nv),
      lp0_(scene.tree.nv),
      ltau_(scene.tree.nv) {
  if (run.pieces.empty()) throw Error("a run without steps has no derivative");
}

// Adds the gradient in the state at a node.
void RunAdjoint::add_node(const RunCost& cost, std::size_t node, const VecX& q, const VecX& p, RunGradient& result) {
  const Eigen::Index row = static_cast<Eigen::Index>(node);
  VecX lq = cost.q.row(row).transpose(), lv = cost.v.row(row).transpose();
  if (lq.isZero(0) && lv.isZero(0)) return;
  VecX v(scene_->tree.nv);
  if (!integrator_.node_velocity(q, p, v)) throw Error("the mass matrix is not positive definite");
  VecX w = v;
  engine_to_public(scene_->tree, q, w);
  to_engine_gradient(scene_->tree, adjoint_, integrator_, {StateKind::kVelocity, q, w, v, p}, lq, lv,
                     result.parameters);
  lq_ += lq;
  lp_ += lv;
}

// The transpose of the step that adjoint_ has taken.
void RunAdjoint::step_back(long step, RunGradient& result) {
  result.begin_step();
  if (!adjoint_.solve(lq_, lp_, lq0_, lp0_, lh_, ltau_))
    throw NoDerivative({"step", -1, run_->t0 + static_cast<double>(step) * run_->dt},
                       "The derivative of a step was not solved", "adjoint equations with a solution", "none",
                       "Use a smaller dt");
  adjoint_.add_parameters(result.parameters);
  lq_ = lq0_;
  lp_ = lp0_;
  inputs_.mask(ltau_);
  result.end_step(step, ltau_);
}

// The rest of no length of a step whose event lies at its end.
void RunAdjoint::leave_node(const VecX& q, const VecX& p, double time) {
  VecX v(scene_->tree.nv);
  if (!integrator_.node_velocity(q, p, v)) throw Error("the mass matrix is not positive definite");
  tangent_.take(q, p, 0.0, inputs_.tau(), time, inputs_.servo(), v.replicate(1, run_->stages));
  StepDirection direction;
  direction.h = 1.0;
  VecX fq(scene_->tree.nv), fp(scene_->tree.nv);
  if (!tangent_.solve(direction, fq, fp)) throw Error("the derivative of a step was not solved");
  ltime_ = -(lq_.dot(fq) + lp_.dot(fp));
}

// The columns of the impact that was taken.
void RunAdjoint::set_impact_matrix() {
  const int n = scene_->tree.nv;
  ImpactDirection direction;
  direction.q = direction.p = VecX::Zero(n);
  direction.e = direction.mu = VecX::Zero(impact_.points());
  direction.checked = false;
  VecX column(n + 1);
  const auto apply = [&] {
    double loss = 0.0;
    impact_.apply(direction, column.head(n), loss);
    column[n] = loss;
    return column;
  };
  const auto number = [&](double& entry) {
    entry = 1.0;
    const VecX found = apply();
    entry = 0.0;
    return found;
  };
  matrix_.q.resize(n + 1, n);
  matrix_.p.resize(n + 1, n);
  for (int k = 0; k < n; ++k) {
    matrix_.q.col(k) = number(direction.q[k]);
    matrix_.p.col(k) = number(direction.p[k]);
  }
  matrix_.e.resize(n + 1, impact_.points());
  matrix_.mu.resize(n + 1, impact_.points());
  for (int i = 0; i < impact_.points(); ++i) {
    matrix_.e.col(i) = number(direction.e[i]);
    matrix_.mu.col(i) = number(direction.mu[i]);
  }
  matrix_.reference = number(direction.reference);
  matrix_.rest = number(direction.rest);
  matrix_.time = number(direction.time);
}

void RunAdjoint::pass_impact(const RecordedImpact& impact, RunGradient& result) {
  check_map(scene_->tree, *run_, impact);
  const RecordedImpact& last = *(&impact + impact.records() - 1);
  impact_.take(impact, last.p_plus, inputs_.tau(), inputs_.servo());
  set_impact_matrix();
  const int n = scene_->tree.nv;
  VecX l(n + 1);
  l << lp_, -lreference_;
  impact_.add_parameters(lp_, adjoint_, result.parameters);
  lq_ += matrix_.q.transpose() * l;
  lp_ = matrix_.p.transpose() * l;
  for (int i = 0; i < impact_.points(); ++i) {
    if (impact_.takes_restitution(i)) result.e[impact_.guard(i)] += matrix_.e.col(i).dot(l);
    result.mu[impact_.guard(i)] += matrix_.mu.col(i).dot(l);
  }
  ltime_ += matrix_.time.dot(l) - matrix_.rest.dot(l);
  lreference_ += matrix_.reference.dot(l);
}

// The impacts at the end of a piece, and its time.
void RunAdjoint::pass_event(const Piece& piece, double time_gradient, RunGradient& result) {
  const EventHit hit = event_hit(*run_, piece, kinks_.taken());
  std::vector<int> firsts;
  for (int i = 0; i < piece.impacts; i += run_->impacts[piece.first_impact + i].records())
    firsts.push_back(piece.first_impact + i);
  for (std::size_t i = firsts.size(); i-- > 0;) pass_impact(run_->impacts[firsts[i]], result);
  const RecordedImpact &impact = run_->impacts[hit.impact], &last = *(&impact + impact.records() - 1);
  impact_.take(impact, last.p_plus, inputs_.tau(), inputs_.servo());
  if (run_->map == ImpactMap::kDtec) {
    lenergy_ = lreference_;
    lreference_ = 0.0;
  }
  VecX fq(scene_->tree.nv), fp(scene_->tree.nv);
  if (piece.has_rows()) {
    contact_.solve_length(fq, fp);
  } else {
    tangent_.take(piece.q, piece.p, piece.h, inputs_.tau(), piece.t, inputs_.servo(), piece.velocities);
    StepDirection direction;
    direction.h = 1.0;
    if (!tangent_.solve(direction, fq, fp)) throw Error("the derivative of a step was not solved");
  }
  double by_time = lq_.dot(fq) + lp_.dot(fp) + ltime_ + time_gradient;
  if (lenergy_ != 0.0) by_time += lenergy_ * (piece.has_rows() ? contact_.energy_change() : tangent_.energy_change());
  // Where several points are hit they have one time along the directions that there are: any of them tells it.
  const VecX W = impact_.gradient(hit.points.empty() ? 0 : impact_.find(*hit.points[0]));
  const double rate = W.dot(fq);
  check_closing(impact, rate, W.cwiseAbs().dot(fq.cwiseAbs()));
  lq_ -= W * (by_time / rate);
  ltime_ = 0.0;
}

// dE = v . dp + dH/dq . dq, with the gradient lreference_ in E.
void RunAdjoint::add_energy_gradient(const VecX& q, const VecX& p) {
  VecX v(scene_->tree.nv), force(scene_->tree.nv);
  if (!integrator_.node_velocity(q, p, v)) throw Error("the mass matrix is not positive definite");
  energy_gradient(integrator_, q, v, force);
  lq_ += lreference_ * force;
  lp_ += lreference_ * v;
  lreference_ = 0.0;
}

void RunAdjoint::pass_piece(const Piece& piece, bool start_moves, RunGradient& result) {
  adjoint_.take(piece.q, piece.p, piece.h, inputs_.tau(), piece.t, inputs_.servo(), piece.velocities);
  step_back(piece.step, result);
  if (lenergy_ != 0.0) {
    // The energy of the piece that DTEC starts from.
    const int n = scene_->tree.nv;
    StepDirection direction;
    VecX dq(n), dp(n);
    const auto energy = [&] {
      if (!tangent_.solve(direction, dq, dp)) throw Error("the derivative of a step was not solved");
      return lenergy_ * tangent_.energy_change();
    };
    direction.h = 1.0;
    lh_ += energy();
    direction.h = 0.0;
    direction.q = direction.p = VecX::Zero(n);
    for (int k = 0; k < n; ++k) {
      direction.q[k] = 1.0;
      lq_[k] += energy();
      direction.q[k] = 0.0;
      direction.p[k] = 1.0;
      lp_[k] += energy();
      direction.p[k] = 0.0;
    }
    lenergy_ = 0.0;
  }
  double lt = 0.0;
  if (start_moves) adjoint_.add_time(lt, lh_);
  if (piece.end != PieceEnd::kLength) ltime_ = -lh_;
  ltime_ += lt;
}

RunGradient RunAdjoint::solve(const RunCost& cost, long steps) {
  const int n = scene_->tree.nv;
  const VecX none = VecX::Zero(n);
  RunGradient result{none,
                     none,
                     MatX::Zero(steps, n),
                     MatX::Zero(steps, n),
                     MatX::Zero(steps, n),
                     VecX::Zero(scene_->guard_count()),
                     VecX::Zero(scene_->guard_count()),
                     StepParameters(scene_->tree)};
  lq_ = lp_ = none;
  ltime_ = lreference_ = lenergy_ = 0.0;
  contact_.start();
  const std::vector<Piece>& pieces = run_->pieces;
  const double same = kSameTime * run_->dt;
  std::size_t node = cost.times.size();
  Eigen::Index event = 0;
  for (const Piece& piece : pieces) event += piece.impacts > 0;
  for (std::size_t i = pieces.size(); i-- > 0;) {
    const Piece& piece = pieces[i];
    const bool last = i + 1 == pieces.size();
    const double end = piece.t + piece.h;
    const VecX &q1 = last ? run_->q_end : pieces[i + 1].q, &p1 = last ? run_->p_end : pieces[i + 1].p;
    for (; node > 0 && cost.times[node - 1] >= end - same; --node) add_node(cost, node - 1, q1, p1, result);
    inputs_.set(piece);
    if (!last) check_beginnings(*run_, piece, pieces[i + 1]);
    if (piece.end == PieceEnd::kTime) ltime_ = 0.0;
    const bool at_node =
        piece.end == PieceEnd::kEvent && (last ? is_node(*run_, end) : pieces[i + 1].step > piece.step);
    if (at_node) {
      check_node(piece, last ? nullptr : &pieces[i + 1]);
      leave_node(q1, p1, end);
    }
    if (piece.has_rows()) {
      contact_.take(piece, inputs_);
      contact_.leave_anchors(lq_);
    }
    if (piece.impacts > 0) {
      --event;
      pass_event(piece, cost.events.size() > event ? cost.events[event] : 0.0, result);
    }
    const bool start_moves = i > 0 && pieces[i - 1].end != PieceEnd::kTime;
    if (piece.has_rows()) {
      contact_.pass(lq_, lp_, ltime_, lenergy_, result);
      lenergy_ = 0.0;
    } else {
      pass_piece(piece, start_moves, result);
    }
    const bool by_step = run_->map == ImpactMap::kMhc && run_->mhc_reference == MhcReference::kStep;
    if (by_step && lreference_ != 0.0 && starts_anew(*run_, i)) add_energy_gradient(piece.q, piece.p);
  }
  contact_.finish();
  const Piece& first = pieces[0];
  if (lreference_ != 0.0) add_energy_gradient(first.q, first.p);
  for (; node > 0; --node) add_node(cost, node - 1, first.q, first.p, result);
  VecX v(n);
  if (!integrator_.node_velocity(first.q, first.p, v)) throw Error("the mass matrix is not positive definite");
  VecX w = v;
  engine_to_public(scene_->tree, first.q, w);
  to_public_gradient(scene_->tree, adjoint_, {StateKind::kVelocity, first.q, w, v, first.p}, lq_, lp_,
                     result.parameters);
  result.q = lq_;
  result.v = lp_;
  return result;
}

}  // namespace contactvi
