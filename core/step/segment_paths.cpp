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

const StepPath* SegmentPaths::path(Eigen::Index segment, StepEquations& equations) {
  if (segment == made_) return &path_;
  made_ = -1;
  const Eigen::Index nv = v0_.size();
  path_.set(q(segment), length(segment), Eigen::Map<const MatX>(segments_.rates + segment * nv * stages_, nv, stages_));
  path_.configuration(1.0, q1_);
  p1_ = Eigen::Map<const VecX>(segments_.p1 + segment * nv, nv);
  if (!equations.node_velocity(path_.q0(), p(segment), v0_) || !equations.node_velocity(q1_, p1_, v1_)) return nullptr;
  path_.raise(v0_, v1_);
  path_.doubt(v0_);
  path_.bound(v1_);
  left_out_ = v0_.norm() / v1_.norm();  // NaN at rest
  made_ = segment;
  return &path_;
}

double SegmentPaths::fraction(double time, Eigen::Index segment) const {
  return std::clamp((time - start(segment)) / length(segment), 0.0, 1.0);
}

bool SegmentPaths::state(double time, StepEquations& equations, VecRef q, VecRef v) {
  const Eigen::Index segment = at(time);
  const StepPath* motion = path(segment, equations);
  if (motion == nullptr) return false;
  motion->configuration(fraction(time, segment), q);
  motion->velocity(fraction(time, segment), v);
  return true;
}

double SegmentPaths::step_to(double time) const {
  const double tau = fraction(time, at(time));
  return tau >= kAtNode && tau <= 1.0 - kAtNode ? tau : 0.0;
}

bool SegmentPaths::state(double time, double tol, Integrator& integrator, VecRef q, VecRef v) {
  const Eigen::Index segment = at(time);
  const double tau = step_to(time);
  const StepPath* motion = path(segment, integrator);
  if (motion == nullptr) return false;
  if (!persistent(segment) && tau > 0.0 && !(left_out_ <= tol) &&
      integrator.solve_part(*motion, tau, motion->q0(), p(segment), VecX(), tol)) {
    integrator.finish(q, p1_);
    if (integrator.node_velocity(q, p1_, v)) return true;
  }
  return state(time, integrator, q, v);
}

}  // namespace contactvi
