// What every impact map is given and gives back. A map is one file: impact_ctec.cpp, impact_dtec.cpp, impact_mhc.cpp.
//
//   p+ = p- + lambda W^T, lambda >= 0;  gamma = W M^-1 p;  G_c = W M^-1 W^T;  loss = (1 - e^2) gamma-^2 / (2 G_c).
//
// CTEC is explicit. DTEC and MHC are one scalar equation in lambda, whose other unknowns are the velocities v of the
// rest of the step from p+: E(lambda) = target. It is solved by the secant method from CTEC's lambda, with dE/dlambda
// ~ gamma+ to start. Where that has no admissible root the map falls back to CTEC and says why.
#pragma once

#include "step/integrator.hpp"

namespace contactvi {

enum class Fallback : int {
  kNone = 0,
  kPlastic = 1,        // gamma+ = 0: the energy equation is singular, and lambda is CTEC's
  kNoConvergence = 2,  // no root near CTEC's
  kInadmissible = 3,   // a root with lambda < 0 or gamma+ <= 0
  kGrazing = 4,        // too slow for the equation to fix lambda: its root lies far from CTEC's
  kPersistent = 5,     // contacts are held: the rest of the step is not the smooth one that the scalar belongs to
};

struct ImpactProblem {
  Integrator& integrator;
  const VecX& q;        // q_c, (nq,)
  const VecX& p_minus;  // (nv,)
  const VecX& W;        // gap gradient at q_c, (nv,)
  const VecX& MinvW;    // M^-1 W^T, (nv,)
  double gamma_minus;   // < 0
  double G_c;
  double restitution;  // in [0, 1]
  double dt;           // full step, for the modified Hamiltonian
  double remainder;    // of the step after the impact
  const VecX& tau;     // (nv,) or empty
  double target;       // value that the map's scalar shall have after the impact; unused by CTEC

  double loss() const { return 0.5 * (1.0 - restitution * restitution) * gamma_minus * gamma_minus / G_c; }
};

struct ImpactResult {
  bool ok = false;
  double impulse = 0;  // lambda
  double jump = 0;     // of the map's own scalar, beyond the loss: what is left of its equation [J]; 0 for CTEC
  int iterations = 0;  // evaluations of the scalar
  Fallback fallback = Fallback::kNone;
};

// The secant iteration shared by the implicit maps. scalar(problem, v of the remainder) is evaluated after the
// integrator has solved the remainder from p- + lambda W.
using StepScalar = double (*)(const ImpactProblem& problem, const VecX& p_plus);
ImpactResult solve_impact(const ImpactProblem& problem, const ImpactResult& ctec, StepScalar scalar, VecRef p);

}  // namespace contactvi
