// Start values for Newton's method where it stalled, from Gauss-Seidel sweeps and from ADMM.
#pragma once

#include <vector>

#include "base/small_linear.hpp"
#include "cone/natural_map.hpp"

namespace contactvi {

class ConeFallback {
 public:
  void reserve(int rows);
  // Sweeps over the contacts, each solved exactly while the others are fixed. lambda: start on entry, last on return.
  void gauss_seidel(const ConeProblem& problem, const NaturalMap& map, int iterations, double* lambda);
  // Alternating direction method of multipliers with De Saxce's correction (Carpentier, Le Lidec, Montaut, "From
  // compliant to rigid contact simulation: a unified and efficient approach", 2024), until primal and dual residual
  // are 1e-10 of their terms. lambda: start on entry, last iterate on return. False: the residuals are larger.
  bool admm(const ConeProblem& problem, const NaturalMap& map, double* lambda);

 private:
  bool factor(const ConeProblem& problem, const NaturalMap& map, double rho);

  SmallLinear linear_;
  std::vector<double> scale_, x_, y_, z_, y_old_;  // scale: lambda = scale y
};

}  // namespace contactvi
