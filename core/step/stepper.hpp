// A one-step method as events and impacts use it: it also solves parts of the step just made, each from its start, and
// tells the energies that belong to its steps.
#pragma once

#include "step/path.hpp"

namespace contactvi {

class Stepper {
 public:
  virtual ~Stepper() = default;
  virtual int stages() const = 0;
  // Solves the step of length h from (q0, p0); tau: generalized force in public coordinates, (nv,) or empty. False when
  // it does not converge from any start values; why() gives the reason.
  virtual bool solve(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) = 0;
  // Solves the part alpha of a step whose path is known, to rounding.
  virtual bool solve_part(const StepPath& path, double alpha, const VecCRef& q0, const VecCRef& p0,
                          const VecX& tau) = 0;
  // End state of the step just solved.
  virtual void finish(VecRef q1, VecRef p1) = 0;
  // The next step starts elsewhere.
  virtual void forget() = 0;
  virtual const char* why() const = 0;
  // X' at the stages of the step just solved, shape (nv, s).
  virtual const MatX& rates() = 0;
  // v = M(q)^-1 p. False if M is not positive.
  virtual bool node_velocity(const VecCRef& q, const VecCRef& p, VecRef v) = 0;

  // As solve(), to rounding: impact maps form differences of such steps.
  virtual bool solve_closely(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) = 0;
  // Of the step just solved [J]: its discrete energy; the work of all but gravity and springs in it; and how much of
  // that is done, in the mean, before the instants whose energies the discrete energy is the mean of.
  virtual double discrete_energy() = 0;
  virtual double work() const = 0;
  virtual double mean_work() const = 0;
  // The energy that steps of length h conserve (step/energy.hpp), at a state and the time t [s].
  virtual double modified_hamiltonian(double t, const VecCRef& q, const VecCRef& p, double h) = 0;
};

}  // namespace contactvi
