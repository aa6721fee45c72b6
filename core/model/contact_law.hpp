// What a pair has beyond its coefficients of restitution and of friction: the laws of contact that few pairs need.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

class ContactFunction;  // model/contact_function.hpp

// A number that depends on another one >= 0, a speed [m/s] or a time [s]: straight lines between the places of a table,
// constant beyond its ends, or a function of the user.
class NumberFunction {
 public:
  NumberFunction() = default;
  // Places ascend, at least one.
  NumberFunction(std::vector<double> places, std::vector<double> values);
  explicit NumberFunction(std::function<double(double)> value);

  bool given() const { return function_ != nullptr || !places_.empty(); }
  double operator()(double place) const;
  // Its derivative; that of a function by differences.
  double slope(double place) const;

 private:
  // Number of the place at which the piece of the table begins in which this one lies; -1 before the table, the last
  // one after it.
  int piece(double place) const;
  double rise(int piece) const;

  std::vector<double> places_, values_;
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
  NumberFunction e;         // of the closing speed, instead of the pair's number
  // Of the closing speed, the speed of the slip before the impact, and the time, instead of e.
  std::shared_ptr<const ContactFunction> e_of_state;
  NumberFunction mu;  // friction of the speed of the slip, instead of the pair's number
  // Of the speed of the slip, the normal force, and the time, instead of mu: see friction_state.hpp.
  std::shared_ptr<const ContactFunction> mu_of_state;
  double static_mu = -1.0;  // friction of what sticks; -1: as that of what slides
  NumberFunction pull;      // adhesion by the time [N], shared by the points that touch
  // Adhesion of its bodies besides, in Scene::body_pulls; -1: none.
  int body_pulls[2] = {-1, -1};
  // Friction that depends on its direction: the axis of the shares, in the frame of the first or the second geometry of
  // the pair, and how much of the coefficient acts along it and across it in the tangent plane.
  int axis_of = -1;
  Vec3 axis = Vec3::Zero();
  Eigen::Vector2d shares = Eigen::Vector2d::Ones();
  // Radii [m] of the friction of a point against spinning and against rolling; 0: none.
  double spinning = 0.0, rolling = 0.0;
  // Whether an impact is not Poisson's in two phases.
  bool is_other() const { return restitution != RestitutionLaw::kPoisson || incremental || tangential > 0.0; }
  bool adheres() const { return pull.given() || body_pulls[0] >= 0; }
  // Rows of a point with friction beside (n, t1, t2).
  int turning_rows() const { return (spinning > 0.0 ? 1 : 0) + (rolling > 0.0 ? 2 : 0); }
};

}  // namespace contactvi
