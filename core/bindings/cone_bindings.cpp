// The solver of the contact problem by itself, for tests and benchmarks.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <chrono>
#include <limits>
#include <optional>
#include <tuple>
#include <vector>

#include "bindings/expose.hpp"
#include "cone/solver.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

using IndexVector = Eigen::Matrix<int, Eigen::Dynamic, 1>;
using Directions = Eigen::Matrix<double, Eigen::Dynamic, 2>;
using Solution = std::tuple<VecX, bool, double, int, int>;

std::vector<ConeContact> contacts_of(const IndexVector& rows, const VecX& mu, const VecX& lower,
                                     const std::optional<Directions>& frozen) {
  const Eigen::Index n = rows.size();
  if (mu.size() != n || lower.size() != n || (frozen && frozen->rows() != n))
    throw nb::value_error("expected rows, mu, lower (n,) and frozen (n, 2) or None for n contacts");
  std::vector<ConeContact> contacts(n);
  int row = 0;
  for (Eigen::Index i = 0; i < n; ++i) {
    ConeContact& c = contacts[i];
    c.row = row;
    c.rows = rows[i];
    c.mu = mu[i];
    c.lower = lower[i];
    c.frozen = frozen && !frozen->row(i).array().isNaN().any();
    if (c.frozen) c.d = frozen->row(i).transpose();
    row += c.rows;
  }
  return contacts;
}

VecX start_of(const std::optional<VecX>& start, Eigen::Index rows) {
  if (start && start->size() != rows) throw nb::value_error("expected start (m,) for b (m,)");
  return start ? *start : VecX(VecX::Zero(rows));
}

Solution solve(const MatX& G, const VecX& b, const IndexVector& rows, const VecX& mu, const VecX& lower,
               const std::optional<Directions>& frozen, const std::optional<VecX>& start, bool regularize,
               double noise) {
  const std::vector<ConeContact> contacts = contacts_of(rows, mu, lower, frozen);
  VecX lambda = start_of(start, b.size());
  ConeSolver solver;
  solver.reserve(static_cast<int>(b.size()));
  const ConeResult r = solver.solve({contacts, G, b, noise}, lambda, regularize);
  return {lambda, r.ok, r.residual, r.iterations, r.fallbacks};
}

// Seconds per call, of the fastest of several blocks; each call starts from `start` again.
double seconds(const MatX& G, const VecX& b, const IndexVector& rows, const VecX& mu, const VecX& lower,
               const std::optional<Directions>& frozen, const std::optional<VecX>& start, bool regularize, int calls,
               int repeats) {
  const std::vector<ConeContact> contacts = contacts_of(rows, mu, lower, frozen);
  const VecX first = start_of(start, b.size());
  VecX lambda = first;
  ConeSolver solver;
  solver.reserve(static_cast<int>(b.size()));
  double best = std::numeric_limits<double>::infinity();
  for (int r = 0; r < repeats; ++r) {
    const auto begin = std::chrono::steady_clock::now();
    for (int k = 0; k < calls; ++k) {
      lambda = first;
      solver.solve({contacts, G, b}, lambda, regularize);
    }
    best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count() / calls);
  }
  return best;
}

}  // namespace

void expose_cone(nb::module_& m) {
  m.def("solve_cone", &solve, "G"_a, "b"_a, "rows"_a, "mu"_a, "lower"_a, "frozen"_a = nb::none(),
        "start"_a = nb::none(), "regularize"_a = true, "noise"_a = 0.0,
        "Coulomb cone problem w = b + G lambda of n contacts with rows[i] = 1 or 3 rows (n, t1, t2) each: G (m, m) "
        "[1/kg], b (m,) [m/s], mu (n,), lower (n,) [N s] bounds of the normal impulses, frozen (n, 2) unit slip "
        "directions (NaN: free), start (m,) [N s], noise [m/s] by which rows of b may disagree. Returns (lambda (m,) "
        "[N s], ok, relative residual, Newton "
        "iterations, fallbacks).");
  m.def("cone_seconds", &seconds, "G"_a, "b"_a, "rows"_a, "mu"_a, "lower"_a, "frozen"_a = nb::none(),
        "start"_a = nb::none(), "regularize"_a = true, "calls"_a = 100, "repeats"_a = 5,
        "Seconds of one solve_cone, without Python, fastest of several blocks; for benchmarks.");
}

}  // namespace contactvi
