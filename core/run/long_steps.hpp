// Smooth steps that are so long that what solves their equations need not be the motion.
//
// The equations of a step in which bodies turn by a good part of a radian may have several solutions. That which
// continues the motion from steps of no length keeps the energy, up to the work of forces, as well as the method does;
// others gain or lose a good part of it. Where bodies turn so far the energy is looked at, which costs a solution with
// the mass matrix; where they do not, one number tells.
#pragma once

#include "step/integrator.hpp"

namespace contactvi {

// What the energy of a motion is compared with. A value: part of the state of a run.
struct EnergyWatch {
  bool known = false;
  double start = 0.0;  // energy less the work done, where it was first looked at after the last impact [J]
  double scale = 0.0;  // the largest kinetic energy, or change of the potential one in a step, that was seen [J]
};

class LongSteps {
 public:
  explicit LongSteps(const Tree& tree);

  // Whether bodies turn so far in a step of length h that it has to be looked at. velocities: at its stages,
  // [dof * stages + stage], a bound on the turns of all joints.
  bool may_be_long(const double* velocities, int stages, double h) const;
  // The same of the step just solved, by the turns themselves, and where there are several stages by how well they
  // resolve the motion.
  bool is_long(StepEquations& equations, double h);

 private:
  const Tree* tree_;
  int depth_ = 0;  // the most turning joints one after the other
  std::vector<double> turn_;
};

// The energy before and after a step, both less the work done up to there, and what it is compared with: the kinetic
// energy before and the rise of the potential one [J].
struct StepEnergy {
  double before, after, kinetic, rise;
};

// Takes a look at a step. False: it is not to be taken.
bool keeps_energy(EnergyWatch& watch, const StepEnergy& energy);
// Whether compliant contacts are resolved by the step from q0 to q1: one that passes a contact in a step or two keeps
// the energy of a linear law, and of no other one. What rests has no motion to compare with, but elastic energy.
bool contacts_keep_energy(const Tree& tree, const StepEnergy& energy, const VecX& q0, const VecX& q1);

}  // namespace contactvi
