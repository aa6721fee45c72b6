#include "step/column_solver.hpp"

#include <algorithm>

namespace contactvi {

namespace {
constexpr int kWidest = 8;  // columns that are solved at once
constexpr int kFew = 4;     // columns for which the kernel of few stages has lanes enough
}  // namespace

ColumnSolver::ColumnSolver(const Tree& tree, const FlatModel& model)
    : tree_(&tree),
      model_(&model),
      few_(&lane_kernel(kFew)),
      many_(&lane_kernel(kMaxStages)),
      X_(static_cast<std::size_t>(tree.nv) * kWidest),
      work_((6 * (tree.joints.size() + std::max(1, model.lanes.slots)) + model.lanes.followers) * kWidest),
      moving_(tree.joints.size(), 0) {
  root_.reserve(tree.joints.size());
  joints_.reserve(tree.joints.size());
  dofs_.reserve(tree.nv);
  for (std::size_t i = 0; i < tree.joints.size(); ++i)
    root_.push_back(tree.joints[i].parent < 0 ? static_cast<int>(i) : root_[tree.joints[i].parent]);
  // Trees that coupled joints hold together move together.
  for (const Follower& f : tree.followers)
    for (const Follower::Leader& leader : f.leaders) {
      const int own = root_[f.joint], other = root_[leader.joint];
      std::replace(root_.begin(), root_.end(), own, other);
    }
  couplings_.reserve(tree.couplings.size());
}

void ColumnSolver::solve(const Stages& stages, Eigen::Ref<MatX> X) {
  const Eigen::Index count = X.cols();
  for (Eigen::Index first = 0; first < count; first += kWidest)
    solve_some(stages, X.middleCols(first, std::min<Eigen::Index>(kWidest, count - first)));
}

// The trees on which a right side acts: all others stay where they are.
void ColumnSolver::list_joints(const Eigen::Ref<MatX>& X) {
  joints_.clear();
  dofs_.clear();
  couplings_.clear();
  std::fill(moving_.begin(), moving_.end(), 0);
  for (std::size_t i = 0; i < root_.size(); ++i) {
    const Joint& joint = tree_->joints[i];
    if (!moving_[root_[i]] && (X.middleRows(joint.iv, joint.nv).array() != 0.0).any()) moving_[root_[i]] = 1;
  }
  for (std::size_t i = 0; i < root_.size(); ++i) {
    if (!moving_[root_[i]]) continue;
    joints_.push_back(static_cast<int>(i));
    for (int d = 0; d < tree_->joints[i].nv; ++d) dofs_.push_back(tree_->joints[i].iv + d);
  }
  for (std::size_t c = 0; c < tree_->couplings.size(); ++c)
    if (moving_[root_[tree_->followers[tree_->couplings[c].first].joint]]) couplings_.push_back(static_cast<int>(c));
}

void ColumnSolver::solve_some(const Stages& stages, Eigen::Ref<MatX> X) {
  const int count = static_cast<int>(X.cols());
  const LaneKernel& kernel = count == 1 ? stages.kernel() : count <= kFew ? *few_ : *many_;
  const int width = (count + kernel.lanes - 1) / kernel.lanes * kernel.lanes;
  list_joints(X);
  for (int k = 0; k < width; ++k) {
    double* lane = X_.data() + k;
    if (k < count) {
      const double* column = X.col(k).data();
      for (int d : dofs_) lane[static_cast<std::ptrdiff_t>(d) * width] = column[d];
    } else {
      for (int d : dofs_) lane[static_cast<std::ptrdiff_t>(d) * width] = 0.0;
    }
  }
  const LaneColumns columns = {width,
                               X_.data(),
                               work_.data(),
                               joints_.data(),
                               static_cast<int>(joints_.size()),
                               stages.coupled(),
                               couplings_.data(),
                               static_cast<int>(couplings_.size())};
  kernel.solve_columns(&model_->lanes, stages.storage(), &columns);
  for (int k = 0; k < count; ++k) {
    const double* lane = X_.data() + k;
    double* column = X.col(k).data();
    for (int d : dofs_) column[d] = lane[static_cast<std::ptrdiff_t>(d) * width];
  }
}

}  // namespace contactvi
