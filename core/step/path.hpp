// The path of one solved step as a polynomial in tau, the fraction of the step in [0, 1].
//
// In the chart at q0, q(tau) = q0 (+) X(tau): X'(tau) = sum_k coef_k P_k(2 tau - 1), X(tau) = h int_0^tau X'. The s
// stage rates give the collocation polynomial, O(h^(s+1)) inside of the step. Raised by M(tau)(a + b (2 tau - 1)), M
// = P_s(2 tau - 1), it takes the velocities of both ends as well: they are true to O(h^2s) however few stages there
// are, M vanishes at the stages, X(1) stays as it is, and the error inside is O(h^(s+2)), that of the stages. With one
// stage it is the cubic Hermite polynomial through both ends, or the one through a half step. Legendre's basis is used
// because |P_k| <= 1 bounds the rates by the sum of their coefficients.
#pragma once

#include "base/gauss.hpp"
#include "model/tree.hpp"

namespace contactvi {

// sum += factor |v|, where each entry of a spherical joint counts as the norm of all three; v, sum: (nv,).
void add_size(const Tree& tree, const VecCRef& v, double factor, VecRef sum);

class StepPath {
 public:
  StepPath(const Tree& tree, int stages);

  // Makes it the collocation polynomial of the step of length h [s] from q0, shape (nq,); rates: X' at the stages,
  // shape (nv, stages).
  void set(const VecCRef& q0, double h, const Eigen::Ref<const MatX>& rates);
  // Raises it by the velocities at its ends, shape (nv,); does nothing if it was raised already.
  void raise(const VecCRef& v0, const VecCRef& v1);
  // Raises it, with one stage, by the velocity at its start and the stage rate of the exact half step. It is then
  // within O(h^4) of the ends of the midpoint rule's partial steps, which agree with the end velocities only to O(h^3).
  void raise_by_half_step(const VecCRef& v0, const VecCRef& half_rate);
  // With one stage and not raised: lets the rates of the partial steps grow linearly from the velocity at its start,
  // until it is raised. Their whole growth counts as doubt.
  void lean(const VecCRef& v0);

  int stages() const { return stages_; }
  double h() const { return h_; }
  const VecX& q0() const { return q0_; }
  bool raised() const { return raised_; }

  void displacement(double tau, VecRef X) const;   // chart coordinates, (nv,)
  void configuration(double tau, VecRef q) const;  // (nq,)
  void chart_rate(double tau, VecRef rate) const;  // X', (nv,)
  void velocity(double tau, VecRef v) const;       // J(X) X', (nv,)
  // As these, of some joints only; the other entries of q and v stay as they are.
  void configuration(double tau, const std::vector<int>& joints, VecRef q) const;
  void velocity(double tau, const std::vector<int>& joints, VecRef v) const;

  // Bound on |v| over the step, (nv,): for each dof, and for the norm of the vector in all three entries of a spherical
  // joint (the Jacobian J of SO(3)'s exponential lengthens no vector).
  void bound(VecRef bound) const;
  // Estimate of the error of the rates from the last coefficients; entries as in bound(). A single stage that was
  // neither raised nor leant gives none: all of its rate then counts as error.
  void doubt(VecRef doubt) const;
  // Bound on |X''|, d/dtau of the rates; entries as in bound().
  void bend(VecRef bend) const;

 private:
  void joint_displacement(const double* I, int iv, int nv, double* X) const;
  void turn_rate(const double* I, int iv, VecRef v) const;

  const Tree* tree_;
  int stages_;
  bool raised_ = false;
  int count_;  // of coefficients in use
  double h_ = 0;
  VecX q0_;
  MatX coef_;      // nv x (stages + 2)
  VecX X_, rate_;  // while the path is raised
};

}  // namespace contactvi
