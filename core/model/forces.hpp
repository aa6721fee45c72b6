// Forces of the elements of a tree (elements.hpp): generalized forces, potentials, powers, and what of them belongs
// into a Newton matrix. Engine coordinates.
#pragma once

#include "model/placement.hpp"

namespace contactvi {

class ForceField {
 public:
  explicit ForceField(const Tree& tree);

  bool any() const { return any_; }
  // Columns of the Newton terms.
  int stiff_columns() const { return stiff_columns_; }

  // [J], of the elements.
  double potential(const VecCRef& q);
  // dV += dV/dq.
  void add_gradient(const VecCRef& q, VecRef dV);
  // d/dt (dV/dq . v) along q' = v, v' = a.
  double power_rate(const VecCRef& q, const VecCRef& v, const VecCRef& a);
  // f += all forces at time t; size += what they are sums of. input() and dissipation() are their powers [W].
  void add(double t, const VecCRef& q, const VecCRef& v, VecRef f, VecRef size);
  double input() const { return input_; }
  double dissipation() const { return dissipation_; }
  // -d(force) ~ J C J^T: J (nv, stiff_columns), C (stiff_columns, stiff_columns), of velocities times `damping` [s] and
  // of places times `stiffness` [s^2].
  void newton_terms(double t, const VecCRef& q, const VecCRef& v, double damping, double stiffness, Eigen::Ref<MatX> J,
                    Eigen::Ref<MatX> C);

 private:
  double length(const PathSpring& spring, VecRef gradient) const;
  double tension(const PathSpring& spring, double length, double speed, double& elastic) const;
  void add_wrenches(double t, const VecCRef& v, VecRef f, VecRef size);
  void add_users(double t, const VecCRef& q, const VecCRef& v, VecRef f, VecRef size);
  void add_matrix(const MatX& public_matrix, const VecCRef& q, double factor, Eigen::Ref<MatX> C);

  const Tree* tree_;
  Placements at_;
  bool any_;
  int stiff_columns_ = 0, user_column_ = -1;  // first column of the users' derivatives
  VecX row_, q_, v_, force_, q_side_, v_side_;
  MatX first_, second_;
  double input_ = 0, dissipation_ = 0;
};

// The same with all potentials: gravity, the joints' springs and the elements.
double total_potential(const Tree& tree, ForceField& field, const Placements& at, const VecCRef& q);

}  // namespace contactvi
