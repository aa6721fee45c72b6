#include "contact/dense_rows.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <utility>

#include "base/error.hpp"
#include "model/coupling.hpp"
#include "model/point_jacobian.hpp"

namespace contactvi {

DenseRows::DenseRows(const Scene& scene) : scene_(&scene), body_rows_(MatX::Zero(scene.tree.nv, 3)) {
  // Blocks: the subtrees of the world's children.
  const Tree& tree = scene.tree;
  problem_.start = {0};
  for (const Joint& joint : tree.joints) {
    const int number = static_cast<int>(tree_of_joint_.size());
    const bool held = std::any_of(tree.couplings.begin(), tree.couplings.end(),
                                  [&](const Coupling& c) { return c.joint < number && number < c.joint_end; });
    if (joint.parent < 0 && !held) problem_.start.push_back(problem_.start.back());
    const int last = problem_.blocks() - 1;
    if (joint.parent >= 0 && tree_of_joint_[joint.parent] != last)
      throw Error("the joints of a tree do not follow each other");
    tree_of_joint_.push_back(last);
    problem_.start.back() = joint.iv + joint.nv;
  }
  int largest = 0;
  for (int b = 0; b < problem_.blocks(); ++b) largest = std::max(largest, problem_.size(b));
  problem_.M.resize(problem_.blocks());
  inverse_.resize(tree.nv, largest);
  problem_.v_free.setZero(tree.nv);
  if (tree.followers.empty()) return;
  const MatX C = complement(tree);
  spare_inverse_ = C * (C.transpose() * C).llt().solve(C.transpose());
}

void DenseRows::set_unit_columns() {
  inverse_.setZero();
  for (int b = 0; b < problem_.blocks(); ++b)
    for (int d = 0; d < problem_.size(b); ++d) inverse_(problem_.start[b] + d, d) = 1.0;
}

void DenseRows::take_inverse() {
  for (int b = 0; b < problem_.blocks(); ++b) {
    const int n = problem_.size(b);
    const auto inverse = inverse_.block(problem_.start[b], 0, n, n);
    if (spare_inverse_.size() > 0) {
      const auto spare = spare_inverse_.block(problem_.start[b], problem_.start[b], n, n);
      problem_.M.set_inverse(b, 0.5 * (inverse + inverse.transpose()) + (inverse.trace() / n) * spare);
      continue;
    }
    problem_.M.set_inverse(b, 0.5 * (inverse + inverse.transpose()));
  }
}

BlockContact& DenseRows::add_block(int a, int b, int rows) {
  BlockContact c;
  c.a = a;
  c.b = b;
  c.row = rows_;
  c.rows = rows;
  c.column = columns_;
  rows_ += rows;
  columns_ += rows * (problem_.size(a) + (b >= 0 ? problem_.size(b) : 0));
  problem_.W.resize(columns_);
  std::fill(problem_.W.begin() + c.column, problem_.W.end(), 0.0);
  problem_.contacts.push_back(c);
  return problem_.contacts.back();
}

// Adds a body's part of the rows of a block, which fill(rows (nv, c.rows)) adds to zeros.
template <class Fill>
void DenseRows::add_rows(const BlockContact& c, int body, const Fill& fill) {
  if (body < 0) return;
  const int tree = tree_of_joint_[body], first = problem_.start[tree], size = problem_.size(tree);
  const int column = tree == c.a ? c.column : c.column + c.rows * problem_.size(c.a);
  body_rows_.block(first, 0, size, c.rows).setZero();
  fill(body_rows_.leftCols(c.rows));
  Eigen::Map<MatX>(problem_.W.data() + column, size, c.rows) += body_rows_.block(first, 0, size, c.rows);
}

void DenseRows::add_contact(const DenseContact& c, bool at_end, const Placements& at) {
  const Contact& contact = at_end ? c.at1 : c.at0;
  const int tree_a = contact.body_a < 0 ? -1 : tree_of_joint_[contact.body_a];
  const int tree_b = contact.body_b < 0 ? -1 : tree_of_joint_[contact.body_b];
  const int first = tree_a >= 0 ? tree_a : tree_b, second = tree_a >= 0 && tree_b != tree_a ? tree_b : -1;
  BlockContact& block = add_block(first, second, c.rows());
  block.mu = c.mu;
  const Vec3& t1 = at_end ? c.t1_1 : c.t1_0;
  const Vec3 directions[3] = {contact.normal, c.shares[0] * t1, c.shares[1] * contact.normal.cross(t1)};
  const auto add = [&](int body, const Vec3& x, double sign) {
    add_rows(block, body, [&](Eigen::Ref<MatX> W) { add_point_rows(scene_->tree, at, body, x, directions, sign, W); });
  };
  add(contact.body_a, contact.point_a, -1.0);
  add(contact.body_b, contact.point_b, 1.0);
}

// The turning friction of the contact with the block `of`.
void DenseRows::add_turning(const DenseContact& c, int of, bool at_end, const Placements& at) {
  const Contact& contact = at_end ? c.at1 : c.at0;
  const BlockContact& block = add_block(problem_.contacts[of].a, problem_.contacts[of].b, 3);
  problem_.contacts.back().of = of;
  problem_.contacts[of].turning = static_cast<int>(problem_.contacts.size()) - 1;
  const Vec3& t1 = at_end ? c.t1_1 : c.t1_0;
  const Vec3 axes[3] = {contact.normal, t1, contact.normal.cross(t1)};
  const double radii[3] = {c.spinning, c.rolling, c.rolling};
  for (const auto& [body, sign] : {std::pair(contact.body_a, -1.0), std::pair(contact.body_b, 1.0)})
    add_rows(block, body, [&, body = body, sign = sign](Eigen::Ref<MatX> W) {
      for (int k = 0; k < 3; ++k) add_turn_row(scene_->tree, at, body, axes[k], sign * radii[k], W.col(k));
    });
}

// Rows that act on coupled joints, as they act on what moves them.
void DenseRows::project(const BlockContact& c) {
  double* w = problem_.W.data() + c.column;
  for (int block : {c.a, c.b}) {
    if (block < 0) continue;
    const int first = problem_.start[block], n = problem_.size(block);
    Eigen::Map<MatX> rows(w, n, c.rows);
    rows -= spare_inverse_.block(first, first, n, n) * rows;
    w += static_cast<std::ptrdiff_t>(c.rows) * n;
  }
}

void DenseRows::clear() {
  problem_.contacts.clear();
  rows_ = columns_ = 0;
}

void DenseRows::set(const std::vector<DenseContact>& contacts, const std::vector<int>& active, bool at_end,
                    const Placements& at, double h) {
  const Tree& tree = scene_->tree;
  clear();
  for (int i : active) {
    const DenseContact& c = contacts[i];
    if (scene_->is_pair(c.point.guard)) {
      add_contact(c, at_end, at);
      continue;
    }
    const JointLimit& limit = tree.limits[c.point.guard - scene_->pairs.size()];
    const int t = tree_of_joint_[limit.joint];
    const BlockContact& block = add_block(t, -1, 1);
    problem_.W[block.column + tree.joints[limit.joint].iv - problem_.start[t]] = limit.upper ? -1.0 : 1.0;
  }
  for (std::size_t k = 0; k < active.size(); ++k)
    if (contacts[active[k]].turns()) add_turning(contacts[active[k]], static_cast<int>(k), at_end, at);
  first_joint_ = problem_.contacts.size();
  const Elements& e = tree.elements;
  for (int dof : e.friction_dofs) {
    const int t = tree_of_joint_[tree.dof_joint[dof]];
    BlockContact& block = add_block(t, -1, 1);
    block.box = 0.5 * h * e.joint_friction[dof];
    problem_.W[block.column + dof - problem_.start[t]] = 1.0;
  }
  problem_.offset.setZero(rows_);
  if (spare_inverse_.size() == 0) return;
  whole_rows_ = problem_.W;
  for (const BlockContact& c : problem_.contacts) project(c);
}

void DenseRows::add_impulses(const VecX& lambda, VecX& p) const {
  const std::vector<double>& W = spare_inverse_.size() > 0 ? whole_rows_ : problem_.W;
  for (const BlockContact& c : problem_.contacts) {
    const int size_a = problem_.size(c.a), size_b = c.b >= 0 ? problem_.size(c.b) : 0;
    for (int r = 0; r < c.rows; ++r) {
      const double* a = W.data() + c.column + r * size_a;
      for (int d = 0; d < size_a; ++d) p[problem_.start[c.a] + d] += lambda[c.row + r] * a[d];
      const double* b = W.data() + c.column + c.rows * size_a + r * size_b;
      for (int d = 0; d < size_b; ++d) p[problem_.start[c.b] + d] += lambda[c.row + r] * b[d];
    }
  }
}

double DenseRows::mobility(std::size_t k) const {
  const BlockContact& c = problem_.contacts[k];
  double sum = 0.0;
  const double* w = problem_.W.data() + c.column;
  for (int block : {c.a, c.b}) {
    if (block < 0) continue;
    const int n = problem_.size(block);
    const Eigen::Map<const VecX> row(w, n);
    sum += row.dot(problem_.M.inverse(block) * row);
    w = problem_.W.data() + c.column + c.rows * n;
  }
  return sum;
}

}  // namespace contactvi
