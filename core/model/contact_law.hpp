// What a pair has beyond its coefficients of restitution and of friction: the laws of contact that few pairs need.
#pragma once

#include <functional>
#include <vector>

namespace contactvi {

// A number that depends on a speed >= 0 [m/s]: straight lines between the places of a table, constant beyond its ends,
// or a function of the user.
class SpeedFunction {
 public:
  SpeedFunction() = default;
  // Places ascend, at least one.
  SpeedFunction(std::vector<double> speeds, std::vector<double> values);
  explicit SpeedFunction(std::function<double(double)> value);

  bool given() const { return function_ != nullptr || !speeds_.empty(); }
  double operator()(double speed) const;
  // Its derivative; that of a function by differences.
  double slope(double speed) const;

 private:
  // The place at which the piece of the table begins in which a speed lies; -1 before the table, the last one after it.
  int piece(double speed) const;
  double rise(int piece) const;

  std::vector<double> speeds_, values_;
  std::function<double(double)> function_;
};

// What the coefficient e of restitution is the ratio of: of impulses (Poisson), of speeds (Newton), of the square root
// of works (Stronge, "Impact mechanics", 2000).
enum class RestitutionLaw : int { kPoisson = 0, kNewton = 1, kEnergetic = 2 };

struct ContactLaw {
  RestitutionLaw restitution = RestitutionLaw::kPoisson;
  // An impact of one point is followed through its impulse (incremental_impact.hpp).
  bool incremental = false;
  // Restitution is lowered where it would make energy.
  bool keeps_energy = true;
  double tangential = 0.0;  // of the slip, where friction holds it
  SpeedFunction e;          // of the closing speed, instead of the pair's number
  // Radii [m] of the friction of a point against spinning and against rolling; 0: none.
  double spinning = 0.0, rolling = 0.0;
  // Whether an impact is not Poisson's in two phases.
  bool is_other() const { return restitution != RestitutionLaw::kPoisson || incremental || tangential > 0.0; }
  // Rows of a point with friction beside (n, t1, t2).
  int turning_rows() const { return (spinning > 0.0 ? 1 : 0) + (rolling > 0.0 ? 2 : 0); }
};

}  // namespace contactvi
