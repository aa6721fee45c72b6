// Forces of the elements of a tree (elements.hpp): generalized forces, potentials, powers, and their terms in a Newton
// matrix. Engine coordinates.
#pragma once

#include "model/compliance.hpp"
#include "model/placement.hpp"

namespace contactvi {

// How far a spring that only pulls is from going slack, or a compliant contact from opening, or beyond it if negative;
// its forces are not zero where this is positive. In units of its size, the sizes of its terms [m].
struct Slackness {
  double value, size;
};

class ForceField {
 public:
  explicit ForceField(const Tree& tree);

  bool any() const { return any_; }
  // Number of columns of the Newton terms, at most.
  int stiff_columns() const { return stiff_columns_; }

  // From now on each spring that only pulls has the law of one branch, wherever its length is: 1 pulls, 0 is slack; by
  // the numbers of the springs, and behind them of the compliant contacts, which press or are open. Null: each has the
  // branch of its length and speed. The vector must live on.
  void hold_branches(const std::vector<char>* pulls) { pulls_ = pulls; }
  // Sets, for the springs with these numbers, which have to be ones that only pull, and for compliant contacts, how far
  // each is from going slack.
  void slackness(const std::vector<int>& laws, const VecCRef& q, const VecCRef& v, std::vector<Slackness>& found);
  // Sets of a compliant contact, by its number among these laws, the gradient of its gap (nv,). Returns its depth [m].
  double depth(int law, const VecCRef& q, VecRef gradient);
  // Whether the force of a compliant contact, by its number among these laws, has a jump where it begins or ends at a
  // state: those of users may.
  bool jumps(int law, const VecCRef& q, const VecCRef& v);

  // Potential energy of the elements [J].
  double potential(const VecCRef& q);
  // dV += dV/dq.
  void add_gradient(const VecCRef& q, VecRef dV);
  // d/dt (dV/dq . v) along q' = v, v' = a.
  double power_rate(const VecCRef& q, const VecCRef& v, const VecCRef& a);
  // f += all forces at time t; size += the sizes of their terms. input() and dissipation() are then their powers [W].
  void add(double t, const VecCRef& q, const VecCRef& v, VecRef f, VecRef size);
  double input() const { return input_; }
  double dissipation() const { return dissipation_; }
  // J (nv, stiff_columns) and C (stiff_columns, stiff_columns) with J C J^T ~ -(damping df/dv + stiffness df/dq), the
  // factors `damping` [s] and `stiffness` [s^2] being those of the step. Returns how many columns come before those
  // that are zero.
  int newton_terms(double t, const VecCRef& q, const VecCRef& v, double damping, double stiffness, Eigen::Ref<MatX> J,
                   Eigen::Ref<MatX> C);

 private:
  double length(const PathSpring& spring, VecRef gradient) const;
  double tension(std::size_t k, double length, double speed, double& elastic) const;
  Slackness openness(const CompliantContact& contact, const VecCRef& v);
  void ask_openness(const std::vector<int>& laws, std::vector<Slackness>& found);
  bool is_open(std::size_t k) const;
  // Where a compliant contact overlaps at the placed configuration, and how it moves. False: not at all.
  bool meets(std::size_t k, const VecCRef& v, Press& press);
  // Sets the velocity of one that touches there, and the rows.
  void move_apart(const CompliantContact& contact, const VecCRef& v, Press& press);
  void ask_laws(const VecCRef& v, bool derivatives);
  // How it presses, in the branch that it has; laws have been asked. False: not at all.
  bool press(std::size_t k, const VecCRef& v, Press& press);
  void add_compliances(const VecCRef& v, VecRef f, VecRef size);
  int compliant_terms(const VecCRef& v, double damping, double stiffness, int column, Eigen::Ref<MatX> J,
                      Eigen::Ref<MatX> C);
  void add_wrenches(double t, const VecCRef& v, VecRef f, VecRef size);
  void add_users(double t, const VecCRef& q, const VecCRef& v, VecRef f, VecRef size);
  void add_matrix(const MatX& public_matrix, const VecCRef& q, double factor, Eigen::Ref<MatX> C);

  const Tree* tree_;
  Placements at_;
  bool any_;
  int stiff_columns_ = 0, user_column_ = -1;  // first column of the users' derivatives
  VecX row_, q_, v_, force_, q_side_, v_side_;
  MatX first_, second_;
  MatX rows_;                        // of a compliant contact: normal and tangents, (nv, 3)
  std::vector<std::size_t> asking_;  // the compliant contacts whose laws are functions
  std::vector<int> place_of_;        // of a compliant contact in asked_
  std::vector<AskedPress> asked_;
  double input_ = 0, dissipation_ = 0;
  const std::vector<char>* pulls_ = nullptr;
};

// Potential energy of gravity, the joints' springs and the elements [J]; at: the placements at q.
double total_potential(const Tree& tree, ForceField& field, const Placements& at, const VecCRef& q);
// The same where that of gravity at q is known.
double total_potential(const Tree& tree, ForceField& field, double gravity, const VecCRef& q);

}  // namespace contactvi
