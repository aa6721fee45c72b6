#include "sensitivity/run_hessian.hpp"

#include "model/coordinates.hpp"

namespace contactvi {

RunHessian::RunHessian(const Scene& scene, const RecordedRun& run)
    : scene_(&scene),
      run_(&run),
      integrator_(scene.tree, run.stages, run.tol, 200),
      inputs_(scene.tree, run),
      hessian_(scene.tree, run.stages),
      public_(scene.tree, run.stages) {
  if (run.pieces.empty()) throw Error("a run without steps has no derivative");
}

void RunHessian::refuse_step(const Piece& piece) const {
  throw NoDerivative({"step", -1, piece.t}, "The second derivative of a step was not solved",
                     "tangent and adjoint equations with a solution", "none", "Use a smaller dt");
}

// What has a derivative, but no second one that is known.
void RunHessian::check() const {
  for (const Piece& piece : run_->pieces) {
    if (piece.persistent)
      throw NoDerivative({"second", -1, piece.t}, "Persistent contacts have no second derivative that is known",
                         "steps without persistent contacts", "one with some", "Use method='gauss-newton'");
    if (piece.end == PieceEnd::kEvent || piece.impacts > 0)
      throw NoDerivative({"second", run_->impacts[piece.first_impact].guard, piece.t + piece.h},
                         "Impacts have no second derivative that is known", "a run without impacts",
                         "one with an impact", "Use method='gauss-newton'");
  }
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
  direction_.tau = direction.tau.rows() > 0 ? VecX(direction.tau.row(run_->pieces[piece].step).transpose()) : VecX();
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
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    const Piece& piece = pieces[i];
    changes_[i].q = dq;
    changes_[i].p = dp;
    inputs_.set(piece);
    tangent.take(piece.q, piece.p, piece.h, inputs_.tau(), piece.t, inputs_.servo(), piece.velocities);
    set_direction(i, direction);
    if (!tangent.solve(direction_, dq, dp)) refuse_step(piece);
    tangent.keep(changes_[i].v, changes_[i].X);
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

void RunHessian::pass_piece(std::size_t i, const RunVector& direction, RunCurvature& result) {
  const Piece& piece = run_->pieces[i];
  StepGradient gradient(scene_->tree.nv), change(scene_->tree.nv);
  inputs_.set(piece);
  hessian_.take(piece.q, piece.p, piece.h, inputs_.tau(), piece.t, inputs_.servo(), piece.velocities);
  set_direction(i, direction);
  hessian_.tangent().resume(direction_, changes_[i].v, changes_[i].X);
  if (!hessian_.solve(direction_, l_.q, l_.v, l_.dq, l_.dv, gradient, change)) refuse_step(piece);
  l_ = {gradient.q, gradient.p, change.q, change.p};
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
  const MatX inputs = MatX::Zero(pieces.back().step + 1, tree.nv);
  RunCurvature result{{none, none, inputs}, {none, none, inputs}};
  l_ = {none, none, none, none};
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
