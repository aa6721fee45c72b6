#include "step/local_tangent.hpp"

#include <algorithm>

namespace contactvi {

namespace {
constexpr int kLanes = kMaxStages;  // columns per evaluation: the widest lanes
}

LocalTangent::LocalTangent(const Tree& tree, const FlatModel& model, const DofPattern& pattern, int points)
    : M(pattern, points),
      B(M),
      C(M),
      K(M),
      P(tree.nv, points),
      G(tree.nv, points),
      tree_(&tree),
      pattern_(&pattern),
      stages_(tree, model, kLanes, 1) {
  std::vector<std::vector<int>> path(tree.nv);
  for (int d = 0; d < tree.nv; ++d) {
    if (tree.dof_parent[d] >= 0) path[d] = path[tree.dof_parent[d]];
    path[d].push_back(d);
    const std::size_t depth = path[d].size();
    if (depth > dofs_.size()) {
      dofs_.resize(depth);
      carried_.resize(depth);
      within_.resize(depth);
    }
    dofs_[depth - 1].push_back(d);
    for (std::size_t level = 0; level < depth; ++level) {
      const int a = path[d][level], entry = pattern.entry(d, pattern.level(a));
      carried_[level].push_back({d, entry});
      if (tree.dof_joint[a] != tree.dof_joint[d]) {
        symmetric_.push_back(entry);
      } else if (a != d) {
        within_[depth - 1].push_back({a, entry});
      }
    }
  }
  for (std::size_t level = 0; level < dofs_.size(); ++level)
    for (const bool velocity : {true, false})
      for (int point = 0; point < points; ++point) jobs_.push_back({point, velocity, static_cast<int>(level)});
}

// The states of the lanes and their directions; lanes without a column repeat the last one.
void LocalTangent::set_lanes(const Job* jobs, int count, const MatX& X, const MatX& v) {
  const long shadow = stages_.work_.shadow;
  for (int d = 0; d < tree_->nv; ++d)
    for (int lane = 0; lane < kLanes; ++lane) {
      const int point = jobs[std::min(lane, count - 1)].point, at = d * kLanes + lane;
      stages_.X_[at] = X(d, point);
      stages_.v_[at] = v(d, point);
      stages_.X_[at + shadow] = stages_.v_[at + shadow] = 0.0;
    }
  for (int lane = 0; lane < count; ++lane) {
    double* const array = (jobs[lane].velocity ? stages_.v_ : stages_.X_) + shadow;
    for (const int d : dofs_[jobs[lane].level]) {
      const Joint& joint = tree_->joints[tree_->dof_joint[d]];
      if (jobs[lane].velocity || joint.type != JointType::kSpherical) {
        array[d * kLanes + lane] = 1.0;
        continue;
      }
      const Vec3 at = X.col(jobs[lane].point).segment<3>(joint.iv);
      const Mat3 turns = so3_right_jacobian_inverse(at);
      for (int k = 0; k < 3; ++k) array[(joint.iv + k) * kLanes + lane] = turns(k, d - joint.iv);
    }
  }
}

void LocalTangent::read_lane(const Job& job, int lane) {
  const long shadow = stages_.work_.shadow;
  const double *dP = stages_.P_ + shadow + lane, *dG = stages_.G_ + shadow + lane;
  PairMatrix &momentum = job.velocity ? M : B, &force = job.velocity ? C : K;
  for (const Entry& e : carried_[job.level]) {
    momentum.row(e.entry)[job.point] = dP[e.dof * kLanes];
    force.row(e.entry)[job.point] = dG[e.dof * kLanes];
  }
  for (const Entry& e : within_[job.level]) {
    momentum.column(e.entry)[job.point] = dP[e.dof * kLanes];
    force.column(e.entry)[job.point] = dG[e.dof * kLanes];
  }
  if (job.level > 0 || !job.velocity) return;
  for (int d = 0; d < tree_->nv; ++d) {
    P(d, job.point) = stages_.P_[d * kLanes + lane];
    G(d, job.point) = stages_.G_[d * kLanes + lane];
  }
}

void LocalTangent::complete() {
  const int points = M.points;
  for (const int e : symmetric_) {
    std::copy_n(M.row(e), points, M.column(e));
    std::copy_n(C.row(e), points, B.column(e));
    std::copy_n(B.row(e), points, C.column(e));
    std::copy_n(K.row(e), points, K.column(e));
  }
}

void LocalTangent::evaluate(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, const Servo* servo,
                            const MatX& X, const MatX& v) {
  stages_.set_servo(servo);
  stages_.begin(q0, p0, h, tau);
  evaluate_jobs(X, v);
}

void LocalTangent::evaluate_at(const VecX& q, const VecX& v) {
  stages_.at(q);
  evaluate_jobs(MatX::Zero(tree_->nv, 1), v);
}

void LocalTangent::evaluate_jobs(const MatX& X, const MatX& v) {
  for (std::size_t first = 0; first < jobs_.size(); first += kLanes) {
    const Job* jobs = jobs_.data() + first;
    const int count = static_cast<int>(std::min<std::size_t>(kLanes, jobs_.size() - first));
    set_lanes(jobs, count, X, v);
    stages_.kernel().evaluate_tangent(&stages_.model_->lanes, &stages_.work_);
    for (int lane = 0; lane < count; ++lane) read_lane(jobs[lane], lane);
  }
  complete();
}

}  // namespace contactvi
