#include "cone/newton.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace contactvi {

namespace {

constexpr double kGoal = 16.0 * std::numeric_limits<double>::epsilon();  // residual that is a few rounding errors
constexpr double kDescent = 1e-4;   // Armijo's share of the predicted decrease of the merit
constexpr double kContracts = 0.1;  // share of the residual that a step with an old factor may leave
constexpr int kHalvings = 12;       // of a Newton step in its line search

bool slips(const ConeProblem& problem, const NaturalMap& map) {
  const auto slips = [](TangentMode mode) { return mode == TangentMode::kSlip || mode == TangentMode::kFrozen; };
  for (int i = 0; i < static_cast<int>(problem.contacts.size()); ++i)
    if (slips(map.mode(i).tangent) || slips(map.mode(i).rolling)) return true;
  return false;
}

}  // namespace

void ConeNewton::reserve(int rows) {
  if (static_cast<int>(w_.size()) >= rows) return;
  linear_.reserve(rows);
  unknowns_.resize(rows);
  factor_unknowns_.resize(rows);
  forget();
  for (auto* v : {&w_, &next_, &next_w_, &trial_, &trial_w_, &product_, &delta_, &weight_}) v->resize(rows);
}

// The unknowns of friction of one kind, of N rows, of which the first is old[0]; x: where next_ has it. ray: its
// direction per unit of the normal impulse, where it has one.
template <int N>
[[gnu::always_inline]] inline void ConeNewton::add_ball(const Ball& ball, double normal, const double* old, double* x,
                                                        double* ray) {
  constexpr int before = 3 - N;  // rows between that from which an unknown counts and the first of friction
  const double friction = ball.mu * normal;
  switch (ball.mode) {
    case TangentMode::kStick:
      for (int k = 0; k < N; ++k) {
        Unknown& u = unknowns_[count_++] = {ball.contact, ball.row - before, 3, {}, {}, 0.0, before + k};
        u.column[before + k] = u.test[before + k] = 1.0;
        x[k] = old[k];
      }
      break;
    case TangentMode::kSlip: {
      const Vec3& e = *ball.e;
      for (int k = 0; k < N; ++k) {
        ray[k] = ball.mu * e[k];
        x[k] = friction * e[k];
      }
      Vec3 t[2] = {Vec3(-e[1], e[0], 0.0), Vec3::Zero()};
      if (N == 3) {
        t[0] = e.unitOrthogonal();
        t[1] = e.cross(t[0]);
      }
      for (int j = 0; j < N - 1; ++j) {
        double tau = t[j][0] * old[0] + t[j][1] * old[1];
        if (N == 3) tau += t[j][2] * old[2];
        delta_[count_] = tau;
        Unknown& u =
            unknowns_[count_++] = {ball.contact, ball.row - before, 3, {}, {}, (1.0 - ball.beta) * ball.scale, -1};
        for (int k = 0; k < N; ++k) {
          u.column[before + k] = t[j][k];
          u.test[before + k] = ball.beta * t[j][k];
          x[k] += tau * t[j][k];
        }
      }
      break;
    }
    case TangentMode::kFrozen:
      for (int k = 0; k < N; ++k) {
        ray[k] = -ball.mu * ball.d[k];
        x[k] = -friction * ball.d[k];
      }
      break;
    default:
      std::fill_n(x, N, 0.0);
  }
}

// Writes the step as unknowns and equations. next_ becomes a point that obeys what the modes fix (an open contact's
// normal impulse, the direction of slip) and is lambda (or zero) elsewhere; the unknowns lead from it to the step's
// end. A slipping contact has two:
//   normal   w_n = 0 along (1, mu e);   across e   (1 - beta) r_t^-1 tau + beta t.w = 0, tau = t.lambda_t
// (Alart-Curnier's derivative with the first equation inserted); one more across e with spinning, and rolling has those
// of a slip of its own.
void ConeNewton::build(const ConeProblem& problem, const NaturalMap& map, const double* lambda, bool from_nothing) {
  static constexpr double kNothing[6] = {};
  count_ = 0;
  int i = 0;
  for (const ConeContact& c : problem.contacts) {
    const ConeMode& mode = map.mode(i);
    double* x = next_.data() + c.row;
    const double* old = from_nothing ? kNothing : lambda + c.row;
    x[0] = mode.closed ? old[0] : mode.bound;
    Unknown normal{i, c.row, 1, {1.0}, {1.0}, 0.0, 0};
    if (c.rows > 1) {
      const double d[3] = {c.d[0], c.d[1], c.d_spin};
      const Ball ball{i, c.row + 1, mode.tangent, &mode.e, mode.beta, map.tangent_scale(i), c.mu, d};
      if (c.spins)
        add_ball<3>(ball, x[0], old + 1, x + 1, normal.column + 1);
      else
        add_ball<2>(ball, x[0], old + 1, x + 1, normal.column + 1);
      normal.rows = c.rows;
    }
    if (c.rows > 3 && c.rolling > 0.0) {
      const int r = c.rolling_row();
      const Ball ball{
          i,         c.row + r,         mode.rolling, &mode.e_rolling, mode.beta_rolling, map.rolling_scale(i),
          c.rolling, c.d_rolling.data()};
      add_ball<2>(ball, x[0], old + r, x + r, normal.column + r);
    }
    if (mode.closed) unknowns_[count_++] = normal;
    ++i;
  }
}

// test . w of an unknown's equation.
inline double ConeNewton::tested(const Unknown& u, const double* w) {
  w += u.row;
  return u.single >= 0 ? w[u.single] : u.test[0] * w[0] + u.test[1] * w[1] + u.test[2] * w[2];
}

// product += a g, or, the first time, product = a g.
inline void add_column(int m, const double* __restrict g, double a, bool first, double* __restrict product) {
  if (first)
    for (int i = 0; i < m; ++i) product[i] = a * g[i];
  else
    for (int i = 0; i < m; ++i) product[i] += a * g[i];
}

// The right side of the unknowns, in delta_; next_w_ is the velocity at next_.
void ConeNewton::right_side() {
  for (int j = 0; j < count_; ++j) {
    const Unknown& u = unknowns_[j];
    double rest = tested(u, next_w_.data());
    if (u.diagonal != 0.0) rest += u.diagonal * delta_[j];
    delta_[j] = -rest;
  }
}

// Fills the matrix of the unknowns.
void ConeNewton::assemble(const ConeProblem& problem, const NaturalMap& map) {
  const int m = static_cast<int>(problem.b.size());
  linear_.resize(count_);
  for (int j = 0; j < count_; ++j) {
    const Unknown& u = unknowns_[j];
    double* product = product_.data();
    double norm = 0.0;
    const double shift = map.shift(u.contact);
    bool first = true;
    for (int k = 0; k < u.rows; ++k) {
      const double a = u.column[k];
      norm += a * a;
      if (a == 0.0) continue;
      add_column(m, problem.G.data() + (u.row + k) * problem.G.outerStride(), a, first, product);
      product[u.row + k] += shift * a;
      first = false;
    }
    weight_[j] = std::sqrt(norm);
    for (int i = 0; i < count_; ++i) linear_.at(i, j) = tested(unknowns_[i], product);
    linear_.at(j, j) += u.diagonal;
  }
}

bool ConeNewton::same_unknowns() const {
  if (factor_ == Factor::kNone || factor_count_ != count_) return false;
  for (int j = 0; j < count_; ++j)
    if (factor_unknowns_[j] != unknowns_[j].kind()) return false;
  return true;
}

void ConeNewton::remember_unknowns(const NaturalMap& map) {
  factor_shift_ = map.shift_times();
  factor_count_ = count_;
  for (int j = 0; j < count_; ++j) factor_unknowns_[j] = unknowns_[j].kind();
}

// Turns delta_ from the right side into the step. False: the matrix is singular, and that ends the run.
bool ConeNewton::solve(const ConeProblem& problem, const NaturalMap& map, Singular singular) {
  if (count_ == 0) return true;
  const bool known = factor_ == Factor::kSingular && factor_shift_ == map.shift_times() && same_unknowns();
  const bool was_singular = known || (count_ > problem.freedoms && map.shift_times() == 0.0);
  if (was_singular && singular == Singular::kStop) {
    factor_ = Factor::kNone;
    return false;
  }
  ++factors_;
  assemble(problem, map);
  remember_unknowns(map);
  factor_ = Factor::kRegular;
  if (!was_singular && linear_.factor()) {
    linear_.substitute(delta_.data());
    return true;
  }
  factor_ = Factor::kNone;
  if (singular == Singular::kStop) return false;
  linear_.minimum_norm(weight_.data(), delta_.data());
  factor_ = Factor::kSingular;
  return true;
}

// The same with the last factor.
void ConeNewton::solve_again() {
  if (factor_ == Factor::kRegular)
    linear_.substitute(delta_.data());
  else
    linear_.minimum_norm_again(delta_.data());
}

// From next_, which obeys what the modes fix, to the step's end.
void ConeNewton::add_step() {
  for (int j = 0; j < count_; ++j) {
    const Unknown& u = unknowns_[j];
    for (int i = 0; i < u.rows; ++i) next_[u.row + i] += u.column[i] * delta_[j];
  }
}

// Undoes a step: the point before it is in product_.
void ConeNewton::take_back(const ConeProblem& problem, NaturalMap& map, double* lambda) {
  std::copy_n(product_.data(), problem.b.size(), lambda);
  map.velocity(problem, lambda, w_.data());
  map.evaluate(problem, lambda, w_.data());
}

// Line search from lambda towards next_. On success lambda and w_ are the new point, evaluated by map.
bool ConeNewton::search(const ConeProblem& problem, NaturalMap& map, double* lambda) {
  const int m = static_cast<int>(problem.b.size());
  past_[visited_++ % kMemory] = map.merit();
  const double merit = *std::max_element(past_, past_ + std::min(kMemory, visited_));
  map.velocity(problem, next_.data(), next_w_.data());
  map.evaluate(problem, next_.data(), next_w_.data());
  if (map.merit() <= (1.0 - 2.0 * kDescent) * merit || map.residual() <= kGoal) {
    std::copy_n(next_.data(), m, lambda);
    std::swap(w_, next_w_);
    return true;
  }
  double part = 1.0;
  for (int halving = 0; halving < kHalvings; ++halving) {
    part *= 0.5;
    for (int i = 0; i < m; ++i) {
      trial_[i] = lambda[i] + part * (next_[i] - lambda[i]);
      trial_w_[i] = w_[i] + part * (next_w_[i] - w_[i]);
    }
    map.evaluate(problem, trial_.data(), trial_w_.data());
    if (map.merit() <= (1.0 - 2.0 * kDescent * part) * merit) {
      std::copy_n(trial_.data(), m, lambda);
      std::swap(w_, trial_w_);
      return true;
    }
  }
  return false;
}

bool ConeNewton::run(const ConeProblem& problem, NaturalMap& map, Singular singular, int max_iterations,
                     double* lambda) {
  singular_ = false;
  visited_ = 0;
  map.velocity(problem, lambda, w_.data());
  map.evaluate(problem, lambda, w_.data());
  residual_ = map.residual();
  bool from_nothing = singular == Singular::kLeastImpulses && !slips(problem, map), anew = false;
  for (int k = 0; k < max_iterations; ++k) {
    // A start may solve the problem already; where singular matrices are to be found, one is factored all the same.
    if (residual_ <= kGoal && (k > 0 || singular == Singular::kMinimumNorm)) break;
    build(problem, map, lambda, from_nothing);
    map.velocity(problem, next_.data(), next_w_.data(), false);
    right_side();
    ++iterations_;
    const bool again = count_ > 0 && !anew && singular != Singular::kStop && !from_nothing &&
                       factor_shift_ == map.shift_times() && same_unknowns();
    anew = false;
    if (again) {
      solve_again();
    } else if (!solve(problem, map, singular)) {
      singular_ = true;
      break;
    }
    if (residual_ <= kGoal && singular == Singular::kStop) break;
    add_step();
    const double before = residual_;
    std::copy_n(lambda, problem.b.size(), product_.data());
    const bool moved = search(problem, map, lambda);
    if (again && !(moved && map.residual() <= std::max(kGoal, kContracts * before))) {
      take_back(problem, map, lambda);
      --visited_;
      anew = true;
      continue;
    }
    if (!moved && !from_nothing) break;
    from_nothing = false;
    if (!moved) {
      map.evaluate(problem, lambda, w_.data());
      continue;
    }
    residual_ = map.residual();
    // Where the residual hardly falls any more it is rounding.
    if (before <= kConeTolerance && residual_ > 0.25 * before) {
      if (residual_ > before) {
        residual_ = before;
        take_back(problem, map, lambda);
      }
      break;
    }
  }
  return residual_ <= kConeTolerance;
}

}  // namespace contactvi
