#include "sensitivity/run_hessian.hpp"

#include <algorithm>
#include <string>

#include "model/coordinates.hpp"

namespace contactvi {

namespace {

[[noreturn]] void refuse(int guard, double time, const char* fact, const char* expected, const std::string& got) {
  throw NoDerivative({"second", guard, time}, fact, expected, got, "Use method='gauss-newton'");
}

// At a time at which a periodic force is unlikely to be what it is at the start.
constexpr double kLater = 0.381966;  // of a step

}  // namespace

RunHessian::RunHessian(const Scene& scene, const RecordedRun& run)
    : scene_(&scene),
      run_(&run),
      integrator_(scene.tree, run.stages, run.tol, 200),
      inputs_(scene.tree, run),
      hessian_(scene.tree, run.stages),
      impact_(scene, run, kinks_),
      impact_second_(scene, run),
      public_(scene.tree, run.stages) {
  if (run.pieces.empty()) throw Error("a run without steps has no derivative");
}

void RunHessian::refuse_step(const Piece& piece) const {
  throw NoDerivative({"step", -1, piece.t}, "The second derivative of a step was not solved",
                     "tangent and adjoint equations with a solution", "none", "Use a smaller dt");
}

// What has a derivative, but no second one that is known.
void RunHessian::check() const {
  const std::vector<Piece>& pieces = run_->pieces;
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    const Piece& piece = pieces[i];
    if (piece.has_rows())
      refuse(-1, piece.t, "Persistent contacts have no second derivative that is known",
             "steps without persistent contacts", "one with some");
    if (piece.impacts > 0) check_impact(piece);
    if (piece.end != PieceEnd::kEvent) continue;
    const int guard = piece.impacts > 0 ? run_->impacts[piece.first_impact].guard : -1;
    const bool last = i + 1 == pieces.size();
    if (piece.impacts == 0 || last || pieces[i + 1].step > piece.step)
      refuse(guard, piece.t + piece.h, "An event at the end of a step has no second derivative that is known",
             "impacts inside of steps", "one at the end");
  }
}

void RunHessian::check_impact(const Piece& piece) const {
  const RecordedImpact& impact = run_->impacts[piece.first_impact];
  const auto refuse_this = [&](const char* fact, const char* expected, const std::string& got) {
    refuse(impact.guard, impact.time, fact, expected, got);
  };
  if (piece.impacts > 1 || impact.block != nullptr || impact.points > 1)
    refuse_this("Impacts of several points have no second derivative that is known", "one point at a time",
                std::to_string(std::max(piece.impacts, impact.points)) + " at once");
  if (run_->map != ImpactMap::kCtec)
    refuse_this("Implicit impact maps have no second derivative that is known", "impact='ctec'",
                run_->map == ImpactMap::kMhc ? "'mhc'" : "'dtec'");
  const ContactLaw* law = scene_->law(impact.guard);
  if (law != nullptr && law->e.given())
    refuse_this("A coefficient of restitution that depends on the speed has no second derivative that is known",
                "a number", "a function of the speed");
  if (scene_->friction(impact.guard) > 0.0)
    refuse_this("Impacts with friction have no second derivative that is known", "friction 0",
                std::to_string(scene_->friction(impact.guard)));
}

void RunHessian::keep_nodes(const RunCost& cost, double until, const VecX& q, const VecX& p, const VecX& dq,
                            const VecX& dp) {
  const double same = kSameTime * run_->dt;
  while (nodes_.size() < cost.times.size() && cost.times[nodes_.size()] <= until + same) {
    VecX v(scene_->tree.nv);
    if (!integrator_.node_velocity(q, p, v)) throw Error("the mass matrix is not positive definite");
    nodes_.push_back({q, v, dq, dp});
  }
}

// The direction of a piece that was taken, from its start.
void RunHessian::set_direction(std::size_t piece, const RunVector& direction) {
  direction_.q = changes_[piece].q;
  direction_.p = changes_[piece].p;
  direction_.h = changes_[piece].h;
  direction_.tau = direction.tau.rows() > 0 ? VecX(direction.tau.row(run_->pieces[piece].step).transpose()) : VecX();
  inputs_.mask(direction_.tau);
}

// Of a piece whose start or end moves.
void RunHessian::check_forces_in_time(const Piece& piece) {
  const Tree& tree = scene_->tree;
  if (!forces_depend_on_time(tree.elements)) return;
  ForceField field(tree);
  VecX first = VecX::Zero(tree.nv), second = first, size = first, v(tree.nv);
  if (!integrator_.node_velocity(piece.q, piece.p, v)) throw Error("the mass matrix is not positive definite");
  field.add(piece.t, piece.q, v, first, size);
  field.add(piece.t + kLater * run_->dt, piece.q, v, second, size);
  if (first != second)
    refuse(-1, piece.t, "A force that depends on time has no second derivative that is known beside an impact",
           "forces of q and v alone where there are impacts", "one that changes with time");
}

// A smooth piece with its inputs.
void RunHessian::take_piece(const Piece& piece) {
  inputs_.set(piece);
  hessian_.take(piece.q, piece.p, piece.h, inputs_.tau(), piece.t, inputs_.servo(), piece.velocities);
}

// Moves the end (dq, dp) of a piece through its impact, and returns the change of the impact's time.
double RunHessian::move_event(std::size_t i, VecX& dq, VecX& dp) {
  const Piece& piece = run_->pieces[i];
  const RecordedImpact& impact = run_->impacts[piece.first_impact];
  PieceChange& change = changes_[i];
  check_forces_in_time(piece);
  impact_.take(impact, impact.p_plus, inputs_.tau(), inputs_.servo());
  StepDirection longer;
  longer.h = 1.0;
  VecX fq(dq.size()), fp(dq.size());
  MatX fv, fX;
  if (!hessian_.tangent().solve(longer, fq, fp)) refuse_step(piece);
  hessian_.tangent().keep(fv, fX);
  const VecX W = impact_.gradient(0);
  const double rate = W.dot(fq);
  check_closing(impact, rate, W.cwiseAbs().dot(fq.cwiseAbs()));
  const double later = -W.dot(dq) / rate;
  change.h += later;
  change.v += later * fv;
  change.X += later * fX;
  dq += later * fq;
  dp += later * fp;
  change.q1 = dq;
  change.p1 = dp;
  ImpactDirection direction;
  direction.q = dq;
  direction.p = dp;
  direction.e = direction.mu = VecX::Zero(1);
  double loss = 0.0;
  impact_.apply(direction, dp, loss);
  return later;
}

void RunHessian::forward(const RunCost& cost, const RunVector& direction) {
  const int n = scene_->tree.nv;
  const std::vector<Piece>& pieces = run_->pieces;
  const Piece& first = pieces[0];
  StepTangent& tangent = hessian_.tangent();
  VecX v(n), dq = direction.q, dp = direction.v;
  if (!integrator_.node_velocity(first.q, first.p, v)) throw Error("the mass matrix is not positive definite");
  VecX w = v;
  engine_to_public(scene_->tree, first.q, w);
  to_engine_direction(scene_->tree, tangent, {StateKind::kVelocity, first.q, w, v, first.p}, dq, dp);
  changes_.assign(pieces.size(), {});
  nodes_.clear();
  keep_nodes(cost, first.t, first.q, first.p, dq, dp);
  double start = 0.0;  // change of the time at which a piece starts
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    const Piece& piece = pieces[i];
    PieceChange& change = changes_[i];
    change.q = dq;
    change.p = dp;
    change.h = piece.end == PieceEnd::kLength ? 0.0 : -start;
    if (start != 0.0) check_forces_in_time(piece);
    take_piece(piece);
    set_direction(i, direction);
    if (!tangent.solve(direction_, dq, dp)) refuse_step(piece);
    tangent.keep(change.v, change.X);
    if (piece.end == PieceEnd::kTime) start = 0.0;
    if (piece.end == PieceEnd::kEvent) {
      start = move_event(i, dq, dp);
      continue;
    }
    const bool last = i + 1 == pieces.size();
    keep_nodes(cost, piece.t + piece.h, last ? run_->q_end : pieces[i + 1].q, last ? run_->p_end : pieces[i + 1].p, dq,
               dp);
  }
  if (nodes_.size() < cost.times.size()) throw Error("a node is later than the run");
}

// The gradients of the cost at the nodes, and their changes along the direction.
void RunHessian::change_cost(const RunCost& cost, const CostHessian& hessian) {
  const Tree& tree = scene_->tree;
  const Eigen::Index count = static_cast<Eigen::Index>(nodes_.size());
  MatX dq(count, tree.nv), dv(count, tree.nv), hq(count, tree.nv), hv(count, tree.nv);
  for (Eigen::Index k = 0; k < count; ++k) {
    const Node& node = nodes_[k];
    public_.take(node.q, node.v, node.dq, node.dp, integrator_);
    VecX moved = node.dq, faster = public_.velocity_change();
    engine_to_public_tangent(tree, node.q, node.dq, node.v, faster);
    engine_to_public(tree, node.q, moved);
    dq.row(k) = moved.transpose();
    dv.row(k) = faster.transpose();
  }
  hessian(dq, dv, hq, hv);
  costs_.clear();
  for (Eigen::Index k = 0; k < count; ++k) {
    MovingGradient l{cost.q.row(k).transpose(), cost.v.row(k).transpose(), hq.row(k).transpose(),
                     hv.row(k).transpose()};
    PublicHessian::add_bracket(tree, dq.row(k).transpose(), l.q, 0.5, l.dq);
    costs_.push_back(std::move(l));
  }
}

void RunHessian::add_node(std::size_t k) {
  MovingGradient l = costs_[k];
  if (l.q.isZero(0) && l.v.isZero(0) && l.dq.isZero(0) && l.dv.isZero(0)) return;
  const Node& node = nodes_[k];
  public_.take(node.q, node.v, node.dq, node.dp, integrator_);
  public_.to_engine(l, integrator_);
  l_.q += l.q;
  l_.v += l.v;
  l_.dq += l.dq;
  l_.dv += l.dv;
}

// The impact at the end of a piece that was taken, and its time.
void RunHessian::pass_event(std::size_t i, const RunVector& direction) {
  const Piece& piece = run_->pieces[i];
  const RecordedImpact& impact = run_->impacts[piece.first_impact];
  const PieceChange& change = changes_[i];
  const Eigen::Index n = scene_->tree.nv;
  impact_.take(impact, impact.p_plus, inputs_.tau(), inputs_.servo());
  impact_second_.take(impact, impact_, change.q1, change.p1);
  impact_second_.apply(l_);
  VecX fq(n), fp(n);
  StepDirection longer;
  longer.h = 1.0;
  if (!hessian_.tangent().solve(longer, fq, fp)) refuse_step(piece);
  const VecX W = value(impact_second_.gradient()), dW = derivative(impact_second_.gradient());
  const double rate = W.dot(fq), nu = -(l_.q.dot(fq) + l_.v.dot(fp) + ltime_.x) / rate;
  l_.q += nu * W;
  l_.dq += nu * dW;
  // moved.h: what l . f changes by at a constant l.
  PartialGradient gradient(scene_->tree.nv), moved(scene_->tree.nv);
  set_direction(i, direction);
  hessian_.tangent().resume(direction_, change.v, change.X);
  const VecX none = VecX::Zero(n);
  if (!hessian_.solve(direction_, l_.q, l_.v, none, none, gradient, moved)) refuse_step(piece);
  l_.dq -= W * ((l_.dq.dot(fq) + l_.dv.dot(fp) + moved.h + ltime_.d) / rate);
}

void RunHessian::pass_piece(std::size_t i, const RunVector& direction, RunCurvature& result) {
  const Piece& piece = run_->pieces[i];
  PartialGradient gradient(scene_->tree.nv), change(scene_->tree.nv);
  take_piece(piece);
  if (piece.end == PieceEnd::kTime) ltime_ = 0.0;
  if (piece.end == PieceEnd::kEvent) pass_event(i, direction);
  set_direction(i, direction);
  hessian_.tangent().resume(direction_, changes_[i].v, changes_[i].X);
  if (!hessian_.solve(direction_, l_.q, l_.v, l_.dq, l_.dv, gradient, change)) refuse_step(piece);
  l_ = {gradient.q, gradient.p, change.q, change.p};
  if (piece.end != PieceEnd::kLength) ltime_ = {-gradient.h, -change.h};
  inputs_.mask(gradient.tau);
  inputs_.mask(change.tau);
  result.gradient.tau.row(piece.step) += gradient.tau.transpose();
  result.product.tau.row(piece.step) += change.tau.transpose();
}

RunCurvature RunHessian::solve(const RunCost& cost, const CostHessian& hessian, const RunVector& direction) {
  check();
  const Tree& tree = scene_->tree;
  const VecX none = VecX::Zero(tree.nv);
  const std::vector<Piece>& pieces = run_->pieces;
  forward(cost, direction);
  change_cost(cost, hessian);
  RunCurvature result;
  result.gradient.tau.setZero(pieces.back().step + 1, tree.nv);
  result.product.tau = result.gradient.tau;
  l_ = {none, none, none, none};
  ltime_ = 0.0;
  const double same = kSameTime * run_->dt;
  std::size_t node = nodes_.size();
  for (std::size_t i = pieces.size(); i-- > 0;) {
    const double end = pieces[i].t + pieces[i].h;
    for (; node > 0 && cost.times[node - 1] >= end - same; --node) add_node(node - 1);
    pass_piece(i, direction, result);
  }
  for (; node > 0; --node) add_node(node - 1);
  const Piece& first = pieces[0];
  VecX v(tree.nv);
  if (!integrator_.node_velocity(first.q, first.p, v)) throw Error("the mass matrix is not positive definite");
  public_.take(first.q, v, changes_[0].q, changes_[0].p, integrator_);
  public_.to_public(l_);
  PublicHessian::add_bracket(tree, direction.q, l_.q, -0.5, l_.dq);
  result.gradient.q = l_.q;
  result.gradient.v = l_.v;
  result.product.q = l_.dq;
  result.product.v = l_.dv;
  return result;
}

}  // namespace contactvi
