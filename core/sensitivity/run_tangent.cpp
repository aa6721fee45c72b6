#include "sensitivity/run_tangent.hpp"

#include <algorithm>
#include <cmath>

#include "model/coordinates.hpp"
#include "step/energy.hpp"

namespace contactvi {

RunTangent::RunTangent(const Scene& scene, const RecordedRun& run, bool take_branch)
    : scene_(&scene),
      run_(&run),
      kinks_(take_branch),
      forces_in_time_(forces_depend_on_time(scene.tree.elements)),
      integrator_(scene.tree, run.stages, run.tol, 200, true),
      tangent_(scene.tree, run.stages),
      map_(scene.tree, run.stages, false),
      node_map_(scene.tree),
      inputs_(scene.tree, run),
      impact_(scene, run, kinks_),
      dq_(scene.tree.nv),
      dp_(scene.tree.nv),
      fq_(scene.tree.nv),
      fp_(scene.tree.nv),
      contact_(scene, run, kinks_) {
  if (run.pieces.empty()) throw Error("a run without steps has no derivative");
}

void RunTangent::start(const RunDirections& d) {
  const int n = scene_->tree.nv;
  const Piece& first = run_->pieces[0];
  columns_.q.setZero(n, d.count);
  columns_.p.setZero(n, d.count);
  VecX v(n), w(n), dq(n), dv(n);
  if (!integrator_.node_velocity(first.q, first.p, v)) throw Error("the mass matrix is not positive definite");
  w = v;
  engine_to_public(scene_->tree, first.q, w);
  for (Eigen::Index k = 0; k < d.count; ++k) {
    dq.setZero();
    dv.setZero();
    if (d.q.size() > 0) dq = d.q.col(k);
    if (d.v.size() > 0) dv = d.v.col(k);
    to_engine_direction(scene_->tree, tangent_, {StateKind::kVelocity, first.q, w, v, first.p}, dq, dv);
    if (d.parameter(k) != nullptr) tangent_.add_momentum(first.q, v, *d.parameter(k), dv);
    columns_.q.col(k) = dq;
    columns_.p.col(k) = dv;
  }
  columns_.time.setZero(d.count);
  contact_.start(d.count);
  size_q_.setZero(d.count);
  size_p_.setZero(d.count);
  reference_.setZero(d.count);
  piece_energy_.setZero(d.count);
  reference_step_ = -1;
  if (run_->map != ImpactMap::kMhc || run_->mhc_reference != MhcReference::kRun) return;
  VecX force(n);
  energy_gradient(integrator_, first.q, v, force);
  reference_ = columns_.p.transpose() * v + columns_.q.transpose() * force;
}

// A step with its inputs.
void RunTangent::take_piece(const Piece& piece) {
  inputs_.set(piece);
  if (piece.has_rows()) {
    contact_.take(piece, inputs_);
    return;
  }
  take_step(piece.q, piece.p, piece.h, piece.t, piece.velocities);
}

// A step with the inputs of the piece, of which the arrays live on.
void RunTangent::take_step(const VecX& q, const VecX& p, double h, double time, const MatX& velocities) {
  step_.emplace(StepSolution{q, p, h, inputs_.tau(), time, inputs_.servo(), velocities});
  tangent_has_step_ = false;
}

// The tangent of the step that was taken.
StepTangent& RunTangent::tangent() {
  if (!tangent_has_step_) {
    const StepSolution& s = *step_;
    tangent_.take(s.q0, s.p0, s.h, s.tau, s.time, s.servo, s.velocities);
  }
  tangent_has_step_ = true;
  return tangent_;
}

// The derivative of the end of the piece that was taken by its length.
void RunTangent::solve_length(const Piece& piece) {
  if (piece.has_rows()) {
    contact_.solve_length(fq_, fp_);
    return;
  }
  direction_ = StepDirection();
  direction_.h = 1.0;
  if (!tangent().solve(direction_, fq_, fp_)) throw Error("the derivative of a step was not solved");
}

// The part of a step up to a time inside of it.
void RunTangent::take_part(Piece& part, double length) {
  if (part.persistent)
    throw NoDerivative({"inside", -1, part.t}, "The state inside of a step with persistent contacts is interpolated",
                       "times of nodes", "a time between them", "Ask at the nodes of the run");
  integrator_.set_time(part.t);
  integrator_.set_servo(inputs_.servo());
  integrator_.forget();
  if (!integrator_.solve_closely(part.q, part.p, length, inputs_.tau()) &&
      !integrator_.solve(part.q, part.p, length, inputs_.tau()))
    throw Error("a part of a recorded step was not solved");
  part.h = length;
  part.end = PieceEnd::kTime;
  if (part.held == nullptr) return take_step(part.q, part.p, length, part.t, integrator_.velocities());
  part_record_ = held_step_record(integrator_, part.q, part.p);
  part.held = &part_record_;
  contact_.take(part, inputs_);
}

// Moves the columns to the end of the piece that was taken, at the time that it ends at or, where it has a given
// length, so long after its start. Fills the derivative by its length.
void RunTangent::move(const Piece& piece, const RunDirections& d) {
  if (piece.has_rows()) {
    contact_.move(d, columns_);
    piece_energy_ = contact_.energies();
    return;
  }
  const bool at_event = piece.end == PieceEnd::kEvent;
  const bool energies = at_event && run_->map == ImpactMap::kDtec;
  const bool by_map = !energies && apply_map(piece, d);
  for (Eigen::Index k = 0; k < d.count; ++k) {
    if (by_map && d.parameter(k) == nullptr) {
      columns_.q.col(k) = q1_.col(k);
      columns_.p.col(k) = p1_.col(k);
    } else {
      direction_.q = columns_.q.col(k);
      direction_.p = columns_.p.col(k);
      direction_.tau = d.tau.size() > 0 ? VecX(d.tau.col(k)) : VecX();
      inputs_.mask(direction_.tau);
      direction_.parameters = d.parameter(k);
      direction_.t = columns_.time[k];
      direction_.h = piece.end == PieceEnd::kLength ? 0.0 : -columns_.time[k];
      if (!tangent().solve(direction_, dq_, dp_))
        throw NoDerivative({"step", -1, piece.t}, "The derivative of a step was not solved",
                           "tangent equations with a solution", "none", "Use a smaller dt");
      if (energies) piece_energy_[k] = tangent_.energy_change();
      columns_.q.col(k) = dq_;
      columns_.p.col(k) = dp_;
    }
    if (piece.end == PieceEnd::kTime) columns_.time[k] = 0.0;
  }
}

// Fills q1_ and p1_ with the columns at the end of the step, of those without parameters, by the step's matrix. False
// where that does not pay or has no solution.
bool RunTangent::apply_map(const Piece& piece, const RunDirections& d) {
  int columns = 0;
  for (Eigen::Index k = 0; k < d.count; ++k) columns += d.parameter(k) == nullptr;
  if (inputs_.any_held() && d.tau.size() > 0) return false;       // it would act with what limits keep from acting
  if (forces_in_time_ && !columns_.time.isZero(0)) return false;  // which it does not know
  if (!map_.pays_for(columns) || !map_.take(*step_)) return false;
  const bool moves = piece.end != PieceEnd::kLength;
  map_.apply(columns_.q, columns_.p, d.tau, moves ? VecX(-columns_.time) : VecX(VecX::Zero(d.count)), q1_, p1_);
  return true;
}

// The reference of an implicit map before the impacts of an event.
void RunTangent::set_reference(const Piece& piece) {
  if (run_->map == ImpactMap::kDtec) {
    reference_ = piece_energy_;
    return;
  }
  if (run_->map != ImpactMap::kMhc || run_->mhc_reference == MhcReference::kRun || reference_step_ == piece.step)
    return;
  reference_step_ = piece.step;
  VecX v(scene_->tree.nv), force(scene_->tree.nv);
  if (!integrator_.node_velocity(step_q_, step_p_, v)) throw Error("the mass matrix is not positive definite");
  energy_gradient(integrator_, step_q_, v, force);
  reference_ = step_columns_.p.transpose() * v + step_columns_.q.transpose() * force;
}

void RunTangent::take_impact(const RecordedImpact& impact) {
  const RecordedImpact& last = *(&impact + impact.records() - 1);
  impact_.take(impact, last.p_plus, inputs_.tau(), inputs_.servo());
}

void RunTangent::apply_impact(const RecordedImpact& impact, const RunDirections& d) {
  check_map(scene_->tree, *run_, impact);
  ImpactDirection direction;
  direction.e = direction.mu = VecX::Zero(impact_.points());
  // A change of q turns the momenta.
  const double momentum = impact.p_minus.cwiseAbs().maxCoeff();
  size_p_ = size_p_.cwiseMax(columns_.p.cwiseAbs().colwise().maxCoeff().transpose()).cwiseMax(momentum * size_q_);
  double loss = 0.0;
  for (Eigen::Index k = 0; k < d.count; ++k) {
    direction.q = columns_.q.col(k);
    direction.p = columns_.p.col(k);
    direction.parameters = d.parameter(k);
    for (int i = 0; i < impact_.points(); ++i) {
      if (d.e.size() > 0 && impact_.takes_restitution(i)) direction.e[i] = d.e(impact_.guard(i), k);
      if (d.mu.size() > 0) direction.mu[i] = d.mu(impact_.guard(i), k);
    }
    direction.size_p = size_p_[k];
    direction.reference = reference_[k];
    direction.rest = -columns_.time[k];
    direction.time = columns_.time[k];
    impact_.apply(direction, dp_, loss);
    columns_.p.col(k) = dp_;
    reference_[k] -= loss;
  }
}

// dT of the hit that was taken, of all columns; approach: how far it is from grazing.
VecX RunTangent::time_change(const EventHit& hit, double& approach) {
  const RecordedImpact& impact = run_->impacts[hit.impact];
  VecX later, size;
  for (std::size_t i = 0; i < std::max<std::size_t>(1, hit.points.size()); ++i) {
    const VecX W = impact_.gradient(hit.points.empty() ? 0 : impact_.find(*hit.points[i]));
    const double rate = W.dot(fq_);
    approach = std::min(approach, check_closing(impact, rate, W.cwiseAbs().dot(fq_.cwiseAbs())));
    const VecX now = columns_.q.transpose() * W / -rate;
    const VecX terms = size_q_ * (W.cwiseAbs().sum() / std::abs(rate));
    if (i == 0) {
      later = now;
      size = terms;
      continue;
    }
    if (((now - later).cwiseAbs().array() <= kTogether * (size + terms).array()).all()) continue;
    kinks_.meet(points_apart(impact, hit));
  }
  return later;
}

void RunTangent::take_event(const Piece& piece, const RunDirections& d, RunDerivative& result) {
  const EventHit hit = event_hit(*run_, piece, kinks_.taken());
  const int first = piece.first_impact;
  const RecordedImpact& impact = run_->impacts[hit.impact];
  take_impact(impact);
  // The derivative by the length of the piece, and how the event moves.
  solve_length(piece);
  double energy_rate = 0.0;
  if (run_->map == ImpactMap::kDtec)
    energy_rate = piece.has_rows() ? contact_.energy_change() : tangent_.energy_change();
  const Eigen::Index row = static_cast<Eigen::Index>(result.events.size());
  result.event_times.conservativeResize(row + 1, d.count);
  double approach = 1.0;
  const VecX later = time_change(hit, approach);
  columns_.move_on(later, fq_, fp_);
  piece_energy_ += energy_rate * later;
  result.event_times.row(row) = later.transpose();
  set_reference(piece);
  EventReport report{hit.impact, impact.time, impact_.points() > 1 ? approach : impact_.approach(), 1.0, 1};
  const int guard = hit.points.empty() ? impact.guard : hit.points[0]->guard;
  for (int i = first; i < first + piece.impacts; i += run_->impacts[i].records()) {
    const RecordedImpact& now = run_->impacts[i];
    if (i != hit.impact || i > first) take_impact(now);
    report.margin = std::min(report.margin, impact_.margin());
    report.approach = std::min(report.approach, impact_.approach());
    if (now.guard != guard && !persists(piece, now.guard)) report.guards = 2;
    apply_impact(now, d);
  }
  result.events.push_back(report);
}

// The rest of a step after an event at its end: of no length, but its start moves.
void RunTangent::reach_node(const VecX& q, const VecX& p, double time, const RunDirections& d) {
  VecX v(scene_->tree.nv);
  if (!integrator_.node_velocity(q, p, v)) throw Error("the mass matrix is not positive definite");
  Piece rest;
  rest.t = time;
  rest.end = PieceEnd::kTime;
  rest_velocities_ = v.replicate(1, run_->stages);
  take_step(q, p, 0.0, time, rest_velocities_);
  move(rest, d);
}

void RunTangent::record(double time, const VecX& q, const VecX& p, const RunDirections& d, RunDerivative& result) {
  const int n = scene_->tree.nv;
  VecX v(n);
  if (!integrator_.node_velocity(q, p, v)) throw Error("the mass matrix is not positive definite");
  MatX D(2 * n, columns_.q.cols());
  p1_ = columns_.p;
  for (Eigen::Index k = 0; k < columns_.q.cols(); ++k) {
    if (d.parameter(k) == nullptr) continue;
    VecX heavier = VecX::Zero(n);
    tangent_.add_momentum(q, v, *d.parameter(k), heavier);
    p1_.col(k) -= heavier;
  }
  const bool together = node_map_.take(q, v);
  if (together) node_map_.to_velocities(columns_.q, p1_);
  VecX w = v;
  engine_to_public(scene_->tree, q, w);
  for (Eigen::Index k = 0; k < columns_.q.cols(); ++k) {
    dq_ = columns_.q.col(k);
    dp_ = p1_.col(k);
    if (together) {
      engine_to_public_tangent(scene_->tree, q, dq_, v, dp_);
      engine_to_public(scene_->tree, q, dq_);
    } else {
      to_public_direction(scene_->tree, tangent_, integrator_, {StateKind::kVelocity, q, w, v, p}, dq_, dp_);
    }
    D.col(k) << dq_, dp_;
  }
  result.times.push_back(time);
  result.nodes.push_back(std::move(D));
}

RunDerivative RunTangent::solve(const RunDirections& given, const std::vector<double>& times) {
  RunDerivative result;
  const bool by_step = given.inputs.size() > 0;
  RunDirections here;  // with the inputs of the present step
  if (by_step) here = given;
  const RunDirections& directions = by_step ? here : given;
  start(directions);
  const double same = kSameTime * run_->dt;
  const double size = std::max(columns_.q.cwiseAbs().maxCoeff(), columns_.p.cwiseAbs().maxCoeff());
  auto wanted = times.begin();
  const std::vector<Piece>& pieces = run_->pieces;
  while (wanted != times.end() && *wanted <= pieces[0].t + same) {
    record(*wanted, pieces[0].q, pieces[0].p, directions, result);
    ++wanted;
  }
  for (std::size_t i = 0; i < pieces.size() && wanted != times.end(); ++i) {
    const Piece& piece = pieces[i];
    if (starts_anew(*run_, i)) {
      step_q_ = piece.q;
      step_p_ = piece.p;
      step_columns_ = columns_;
      if (run_->mhc_reference == MhcReference::kStep) reference_step_ = -1;
    }
    if (by_step) here.tau = given.inputs.row(piece.step).transpose();
    take_piece(piece);
    size_q_ = size_q_.cwiseMax(columns_.q.cwiseAbs().colwise().maxCoeff().transpose());
    const double end = piece.t + piece.h;
    // Times inside of the piece: from the same start by a part of the step.
    while (wanted != times.end() && *wanted < end - same) {
      const RunColumns before = columns_;
      Piece part = piece;
      take_part(part, *wanted - piece.t);
      VecX q1(scene_->tree.nq), p1(scene_->tree.nv);
      integrator_.finish(q1, p1);
      move(part, directions);
      record(*wanted, q1, p1, directions, result);
      columns_ = before;
      ++wanted;
      take_piece(piece);
    }
    if (wanted == times.end()) break;
    move(piece, directions);
    if (piece.impacts > 0) take_event(piece, directions, result);
    if (piece.dense != nullptr) result.dense.push_back(contact_.dense_report());
    if (piece.has_rows()) contact_.keep_anchors(columns_);
    const bool last = i + 1 == pieces.size();
    if (piece.end == PieceEnd::kEvent && (last ? is_node(*run_, end) : pieces[i + 1].step > piece.step)) {
      check_node(piece, last ? nullptr : &pieces[i + 1]);
      reach_node(last ? run_->q_end : pieces[i + 1].q, last ? run_->p_end : pieces[i + 1].p, end, directions);
    }
    if (!last) check_beginnings(*run_, piece, pieces[i + 1]);
    if (size > 0.0)
      result.growth =
          std::max({result.growth, columns_.q.cwiseAbs().maxCoeff() / size, columns_.p.cwiseAbs().maxCoeff() / size});
    while (wanted != times.end() && (last || *wanted <= end + same)) {
      record(*wanted, last ? run_->q_end : pieces[i + 1].q, last ? run_->p_end : pieces[i + 1].p, directions, result);
      ++wanted;
    }
  }
  result.kinks = kinks_.met();
  return result;
}

}  // namespace contactvi
