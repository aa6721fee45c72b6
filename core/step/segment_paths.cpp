#include "step/segment_paths.hpp"

#include <algorithm>

namespace contactvi {

namespace {
constexpr double kAtNode = 1e-9;  // fraction of a segment; nearer to an end the polynomial is the node
}

SegmentPaths::SegmentPaths(const Tree& tree, int stages, const SegmentArrays& segments)
    : tree_(&tree),
      segments_(segments),
      stages_(stages),
      path_(tree, stages),
      q1_(tree.nq),
      p1_(tree.nv),
      v0_(tree.nv),
      v1_(tree.nv) {}

Eigen::Index SegmentPaths::at(double time) const {
  const double* end = segments_.t + segments_.count;
  return std::max<Eigen::Index>(0, std::upper_bound(segments_.t, end, time) - segments_.t - 1);
}

void SegmentPaths::set(Eigen::Index segment) {
  if (segment == set_) return;
  const Eigen::Index nv = v0_.size();
  path_.set(q(segment), length(segment), Eigen::Map<const MatX>(segments_.rates + segment * nv * stages_, nv, stages_));
  find_left_out();
  set_ = segment;
}

void SegmentPaths::find_left_out() {
  path_.doubt(v0_);
  path_.bound(v1_);
  left_out_ = v0_.norm() / v1_.norm();  // NaN at rest
}

const StepPath* SegmentPaths::path(Eigen::Index segment, StepEquations& equations) {
  set(segment);
  if (path_.raised()) return &path_;
  path_.configuration(1.0, q1_);
  p1_ = Eigen::Map<const VecX>(segments_.p1 + segment * p1_.size(), p1_.size());
  if (!equations.node_velocity(path_.q0(), p(segment), v0_) || !equations.node_velocity(q1_, p1_, v1_)) return nullptr;
  path_.raise(v0_, v1_);
  find_left_out();
  return &path_;
}

// Whether the polynomial leaves out no more than tol even before it is raised.
bool SegmentPaths::is_enough(double time, double tol) {
  const Eigen::Index segment = at(time);
  if (persistent(segment)) return false;
  set(segment);
  return left_out_ <= tol;
}

double SegmentPaths::fraction(double time, Eigen::Index segment) const {
  return std::clamp((time - start(segment)) / length(segment), 0.0, 1.0);
}

void SegmentPaths::read(double time, VecRef q, VecRef v) const {
  path_.configuration(fraction(time, set_), q);
  path_.velocity(fraction(time, set_), v);
}

bool SegmentPaths::state(double time, StepEquations& equations, VecRef q, VecRef v) {
  if (path(at(time), equations) == nullptr) return false;
  read(time, q, v);
  return true;
}

double SegmentPaths::step_to(double time) const {
  const double tau = fraction(time, at(time));
  return tau >= kAtNode && tau <= 1.0 - kAtNode ? tau : 0.0;
}

bool SegmentPaths::make_step(double time, double tol, Integrator& integrator, VecRef q, VecRef p) {
  const Eigen::Index segment = at(time);
  const double tau = step_to(time);
  if (persistent(segment) || tau == 0.0) return false;
  const StepPath* motion = path(segment, integrator);
  integrator.set_time(start(segment));
  if (motion == nullptr || left_out_ <= tol ||
      !integrator.solve_part(*motion, tau, motion->q0(), this->p(segment), VecX(), tol))
    return false;
  integrator.finish(q, p);
  return true;
}

bool SegmentPaths::state(double time, double tol, Integrator& integrator, VecRef q, VecRef v) {
  if (is_enough(time, tol)) {
    read(time, q, v);
    return true;
  }
  return (make_step(time, tol, integrator, q, p1_) && integrator.node_velocity(q, p1_, v)) ||
         state(time, integrator, q, v);
}

bool SegmentPaths::momentum(double time, double tol, Integrator& integrator, VecRef q, VecRef p) {
  if (is_enough(time, tol)) {
    read(time, q, v0_);
  } else {
    if (make_step(time, tol, integrator, q, p)) return true;
    if (!state(time, integrator, q, v0_)) return false;
  }
  integrator.dynamics(q, v0_, p, v1_);
  return true;
}

}  // namespace contactvi
