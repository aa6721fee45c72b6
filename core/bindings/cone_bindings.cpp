// The solvers of the contact problem by themselves, for tests and benchmarks.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <chrono>
#include <limits>
#include <memory>
#include <optional>
#include <tuple>
#include <vector>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "cone/block_factor.hpp"
#include "cone/block_solver.hpp"
#include "cone/block_system.hpp"
#include "cone/interior_point.hpp"
#include "cone/reduced_solver.hpp"
#include "cone/solver.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

using IndexVector = Eigen::Matrix<int, Eigen::Dynamic, 1>;
using Directions = Eigen::Matrix<double, Eigen::Dynamic, 2>;
using Solution = std::tuple<VecX, bool, double, int, int>;

std::vector<ConeContact> contacts_of(const IndexVector& rows, const VecX& mu, const VecX& lower,
                                     const std::optional<Directions>& frozen, const std::optional<VecX>& box) {
  const Eigen::Index n = rows.size();
  if (mu.size() != n || lower.size() != n || (frozen && frozen->rows() != n) || (box && box->size() != n))
    throw Error("expected rows, mu, lower (n,), frozen (n, 2) or None, box (n,) or None for n contacts");
  std::vector<ConeContact> contacts(n);
  int row = 0;
  for (Eigen::Index i = 0; i < n; ++i) {
    ConeContact& c = contacts[i];
    c.row = row;
    c.rows = rows[i];
    c.mu = mu[i];
    c.lower = lower[i];
    c.frozen = frozen && !frozen->row(i).array().isNaN().any();
    if (box) c.box = (*box)[i];
    if (c.frozen) c.d = frozen->row(i).transpose();
    row += c.rows;
  }
  return contacts;
}

VecX start_of(const std::optional<VecX>& start, Eigen::Index rows) {
  if (start && start->size() != rows) throw Error("expected start (m,) for b (m,)");
  return start ? *start : VecX(VecX::Zero(rows));
}

Solution solve(const MatX& G, const VecX& b, const IndexVector& rows, const VecX& mu, const VecX& lower,
               const std::optional<Directions>& frozen, const std::optional<VecX>& start, bool regularize, double noise,
               double accept, const std::optional<VecX>& box) {
  const std::vector<ConeContact> contacts = contacts_of(rows, mu, lower, frozen, box);
  VecX lambda = start_of(start, b.size());
  ConeSolver solver;
  solver.reserve(static_cast<int>(b.size()));
  const ConeResult r = solver.solve({contacts, G, b, noise, 0.0, accept}, lambda, regularize);
  return {lambda, r.ok, r.residual, r.iterations, r.fallbacks};
}

// rolling (n,), 0: no such rows; frozen (n, 5): directions of slip, spin and rolling, or NaN.
Solution solve_turning(const MatX& G, const VecX& b, const IndexVector& rows, const VecX& mu, const VecX& rolling,
                       const VecX& lower, const std::optional<MatX>& frozen, const std::optional<VecX>& start,
                       bool regularize) {
  std::vector<ConeContact> contacts = contacts_of(rows, mu, lower, std::nullopt, std::nullopt);
  const auto n = static_cast<Eigen::Index>(contacts.size());
  if (rolling.size() != n || (frozen && (frozen->rows() != n || frozen->cols() != 5)))
    throw Error("expected rolling (n,), frozen (n, 5) or None for n contacts");
  for (Eigen::Index i = 0; i < n; ++i) {
    ConeContact& c = contacts[static_cast<std::size_t>(i)];
    c.rolling = rolling[i];
    c.spins = c.rows == 4 || c.rows == 6;
    if (!frozen) continue;
    c.frozen = !std::isnan((*frozen)(i, 0));
    if (c.frozen) c.d = frozen->row(i).head<2>();
    if (c.frozen && c.spins) c.d_spin = (*frozen)(i, 2);
    c.frozen_rolling = !std::isnan((*frozen)(i, 3));
    if (c.frozen_rolling) c.d_rolling = frozen->row(i).tail<2>();
  }
  VecX lambda = start_of(start, b.size());
  ConeSolver solver;
  const ConeResult r = solver.solve({contacts, G, b}, lambda, regularize);
  return {lambda, r.ok, r.residual, r.iterations, r.fallbacks};
}

// Seconds per call, of the fastest of several blocks; each call starts from `start` again.
double seconds(const MatX& G, const VecX& b, const IndexVector& rows, const VecX& mu, const VecX& lower,
               const std::optional<Directions>& frozen, const std::optional<VecX>& start, bool regularize, int calls,
               int repeats, const std::optional<VecX>& box) {
  const std::vector<ConeContact> contacts = contacts_of(rows, mu, lower, frozen, box);
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

using IndexPairs = Eigen::Matrix<int, Eigen::Dynamic, 2, Eigen::RowMajor>;

const char* name_of(BlockResult::Stage stage) {
  switch (stage) {
    case BlockResult::Stage::kSweeps:
      return "sweeps";
    case BlockResult::Stage::kNewton:
      return "newton";
    case BlockResult::Stage::kInteriorPoint:
      return "interior point";
    case BlockResult::Stage::kRepaired:
      return "repaired";
    case BlockResult::Stage::kBlended:
      return "blended";
    case BlockResult::Stage::kFailed:
      break;
  }
  return "failed";
}

// A block problem with its solver.
class BlockContacts {
 public:
  BlockContacts(const IndexVector& sizes, const VecX& masses, const IndexPairs& blocks, const IndexVector& rows,
                const VecX& mu, const VecX& lower, const VecX& box, const VecX& W, const VecX& v_free,
                const VecX& offset, const std::optional<MatX>& equations, const std::optional<IndexVector>& turning) {
    const Eigen::Index m = rows.size();
    if (blocks.rows() != m || mu.size() != m || lower.size() != m || box.size() != m ||
        (turning && turning->size() != m))
      throw Error("expected blocks (m, 2) and rows, mu, lower, box, turning (m,) for m contacts");
    problem_.start.push_back(0);
    Eigen::Index read = 0;
    for (const int n : sizes) {
      if (n < 0 || read + n * n > masses.size()) throw Error("expected masses of sizes[i]^2 numbers each");
      problem_.start.push_back(problem_.start.back() + n);
      const int block = problem_.M.count();
      problem_.M.resize(block + 1);
      problem_.M.set(block, Eigen::Map<const MatX>(masses.data() + read, n, n));
      read += n * n;
    }
    int row = 0, column = 0;
    for (Eigen::Index i = 0; i < m; ++i) {
      BlockContact c;
      c.a = blocks(i, 0);
      c.b = blocks(i, 1);
      for (const int block : {c.a, c.b})
        if (block >= sizes.size() || block < (block == c.a ? 0 : -1)) throw Error("no such block");
      c.row = row;
      c.rows = rows[i];
      c.column = column;
      c.mu = mu[i];
      c.lower = lower[i];
      c.box = box[i];
      if (turning) c.of = (*turning)[i];
      if (c.of >= static_cast<int>(problem_.contacts.size())) throw Error("turning friction stands behind its point");
      if (c.of >= 0) problem_.contacts[c.of].turning = static_cast<int>(i);
      row += c.rows;
      column += c.rows * (problem_.size(c.a) + (c.b < 0 ? 0 : problem_.size(c.b)));
      problem_.contacts.push_back(c);
    }
    if (W.size() != column || offset.size() != row || v_free.size() != problem_.start.back())
      throw Error("expected W of rows x (size a + size b) numbers per contact, offset (rows,), v_free (nv,)");
    problem_.W.assign(W.data(), W.data() + W.size());
    problem_.v_free = v_free;
    problem_.offset = offset;
    if (equations) {
      if (equations->rows() != v_free.size()) throw Error("expected equations (nv, m)");
      equations_ = *equations;
      reduced_ = std::make_unique<ReducedSolver>();
    }
    prepare();
  }
  void set_free(const VecX& v_free, const VecX& offset) {
    if (v_free.size() != problem_.v_free.size() || offset.size() != problem_.offset.size())
      throw Error("expected v_free (nv,) and offset (rows,)");
    problem_.v_free = v_free;
    problem_.offset = offset;
  }
  Dict solve(const std::optional<VecX>& start, double bound, double tolerance, double accept, int sweeps,
             int newton_steps, int factors) {
    VecX lambda = start_of(start, problem_.rows()), v = problem_.v_free;
    const BlockResult r = run(bound, {tolerance, accept, sweeps, newton_steps, factors}, lambda, v);
    return named(r, std::move(lambda), std::move(v));
  }
  Dict solve_normals(const std::optional<VecX>& start, double tolerance) {
    VecX lambda = start_of(start, problem_.rows()), v = problem_.v_free;
    const BlockResult r = run_normals(tolerance, lambda, v);
    return named(r, std::move(lambda), std::move(v));
  }
  // The convex problem of frozen slip speeds, cold.
  std::tuple<VecX, double, int> solve_convex(const VecX& slip, double tolerance) {
    if (slip.size() != static_cast<Eigen::Index>(problem_.contacts.size())) throw Error("expected slip (m,)");
    BlockSystem system;
    VecX lambda = VecX::Zero(problem_.rows());
    if (!system.prepare(problem_) || !system.start(problem_)) return {lambda, 0.0, 0};
    BlockFactor factor;
    factor.analyse(problem_);
    InteriorPoint<BlockSystem, BlockFactor> interior;
    ConePoint point;
    point.lambda.assign(problem_.contacts.size(), Vec3::Zero());
    system.update(point);
    const std::vector<double> frozen(slip.begin(), slip.end());
    point.residual = std::numeric_limits<double>::infinity();
    const int used = interior.run(system, factor, &frozen, tolerance, 60, point);
    for (std::size_t i = 0; i < point.lambda.size(); ++i)
      for (int r = 0; r < problem_.contacts[i].rows; ++r) lambda[problem_.contacts[i].row + r] = point.lambda[i][r];
    return {lambda, point.residual, used};
  }
  // (M + W K W^T)^-1 x, K (3, 3) per contact.
  VecX solve_weighted(const Rows& K, VecX x, bool symmetric) {
    const Eigen::Index m = static_cast<Eigen::Index>(problem_.contacts.size());
    if (K.rows() != 3 * m || K.cols() != 3 || x.size() != problem_.v_free.size())
      throw Error("expected K (3 m, 3) and x (nv,)");
    std::vector<Mat3> weights(m);
    for (Eigen::Index i = 0; i < m; ++i) weights[i] = K.middleRows(3 * i, 3);
    BlockFactor factor;
    factor.analyse(problem_);
    if (!factor.factor(problem_, weights, symmetric) || !factor.solve(x)) throw Error("singular");
    return x;
  }
  // Seconds of one prepare and solve, of the fastest of several.
  double seconds(const std::optional<VecX>& start, double bound, double tolerance, double accept, int sweeps,
                 int newton_steps, int factors, bool prepare, int repeats) {
    return fastest(start, repeats, [&](VecX& lambda, VecX& v) {
      if (prepare) this->prepare();
      run(bound, {tolerance, accept, sweeps, newton_steps, factors}, lambda, v);
    });
  }
  double seconds_normals(const std::optional<VecX>& start, double tolerance, int repeats) {
    return fastest(start, repeats, [&](VecX& lambda, VecX& v) { run_normals(tolerance, lambda, v); });
  }

 private:
  void prepare() {
    if (!reduced_) return solver_.prepare(problem_);
    reduced_->set_equations(problem_, equations_);
    reduced_->prepare(problem_);
  }
  BlockResult run(double bound, const BlockOptions& options, VecX& lambda, VecX& v) {
    return reduced_ ? reduced_->solve(problem_, bound, options, lambda, v)
                    : solver_.solve(problem_, bound, options, lambda, v);
  }
  BlockResult run_normals(double tolerance, VecX& lambda, VecX& v) {
    return reduced_ ? reduced_->solve_normals(problem_, tolerance, lambda, v)
                    : solver_.solve_normals(problem_, tolerance, lambda, v);
  }
  // Seconds of the fastest of several calls of solve(lambda, v), each from `start` again.
  template <class Solve>
  double fastest(const std::optional<VecX>& start, int repeats, const Solve& solve) {
    const VecX first = start_of(start, problem_.rows());
    VecX lambda = first, v = problem_.v_free;
    double best = std::numeric_limits<double>::infinity();
    for (int k = 0; k < repeats; ++k) {
      lambda = first;
      const auto begin = std::chrono::steady_clock::now();
      solve(lambda, v);
      best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
    }
    return best;
  }
  static Dict named(const BlockResult& r, VecX&& lambda, VecX&& v) {
    nb::dict out;
    out["impulses"] = hand_over(std::move(lambda));
    out["v"] = hand_over(std::move(v));
    out["stage"] = name_of(r.stage);
    out["residual"] = r.residual;
    out["scale"] = r.scale;
    out["violation"] = r.violation;
    out["energy"] = r.energy;
    out["free_energy"] = r.free_energy;
    out["blend"] = r.blend;
    out["sweeps"] = r.sweeps;
    out["factors"] = r.factors;
    return Dict(out);
  }
  BlockProblem problem_;
  BlockSolver solver_;
  MatX equations_;
  std::unique_ptr<ReducedSolver> reduced_;  // null: the BlockSolver itself
};

void expose_block_contacts(nb::module_& m) {
  const BlockOptions usual;
  nb::class_<BlockContacts>(m, "BlockContacts", "A contact problem of many blocks and its solver, for tests.")
      .def(nb::init<const IndexVector&, const VecX&, const IndexPairs&, const IndexVector&, const VecX&, const VecX&,
                    const VecX&, const VecX&, const VecX&, const VecX&, const std::optional<MatX>&,
                    const std::optional<IndexVector>&>(),
           "sizes"_a, "masses"_a, "blocks"_a, "rows"_a, "mu"_a, "lower"_a, "box"_a, "W"_a, "v_free"_a, "offset"_a,
           "equations"_a = nb::none(), "turning"_a = nb::none(),
           "sizes (b,): degrees of freedom of each block; masses: their matrices, one after the other [kg]; blocks "
           "(m, 2): the blocks of each contact, -1 for the world as second; rows (m,): 3 (n, t1, t2) or 1; mu (m,), "
           "lower (m,) [N s], box (m,) [N s], > 0 for joint friction; W: per contact rows x size of the first block, "
           "then rows x size of the second; v_free (nv,) and offset (rows,) [m/s]; equations (nv, m): W_e^T v stays "
           "what it "
           "is in v_free. With them, m = 0 too, the problem is reduced first as in dense steps (ReducedSolver). "
           "turning (m,): of rows (spin, roll1, roll2) the number of their point, which stands before them; else -1.")
      .def("set_free", &BlockContacts::set_free, "v_free"_a, "offset"_a, "New data of the same contacts.")
      .def("solve", &BlockContacts::solve, "start"_a = nb::none(), "bound"_a = std::numeric_limits<double>::infinity(),
           "tolerance"_a = usual.tolerance, "accept"_a = usual.accept, "sweeps"_a = usual.sweeps,
           "newton_steps"_a = usual.newton_steps, "factors"_a = usual.factors,
           "Impulses (rows,) [N s], velocity v (nv,), stage, residual (over the scale [m/s]), violation [m/s], energy "
           "[J], free_energy [J], blend, sweeps, factors. start (rows,) [N s]; bound of the energy [J].")
      .def("solve_normals", &BlockContacts::solve_normals, "start"_a = nb::none(), "tolerance"_a = usual.tolerance,
           "The normal impulses anew for the tangential ones of start; the same results.")
      .def("solve_convex", &BlockContacts::solve_convex, "slip"_a, "tolerance"_a = 1e-9,
           "Impulses (rows,) of the law with frozen slip speeds (m,) [m/s], residual, factorizations.")
      .def("solve_weighted", &BlockContacts::solve_weighted, "K"_a, "x"_a, "symmetric"_a,
           "(M + W K W^T)^-1 x with matrices K (3 m, 3) of the contacts, x (nv,).")
      .def("seconds", &BlockContacts::seconds, "start"_a = nb::none(),
           "bound"_a = std::numeric_limits<double>::infinity(), "tolerance"_a = usual.tolerance,
           "accept"_a = usual.accept, "sweeps"_a = usual.sweeps, "newton_steps"_a = usual.newton_steps,
           "factors"_a = usual.factors, "prepare"_a = true, "repeats"_a = 3,
           "Seconds of one solve, with its preparation or without, the fastest of several.")
      .def("seconds_normals", &BlockContacts::seconds_normals, "start"_a = nb::none(), "tolerance"_a = usual.tolerance,
           "repeats"_a = 3, "The same of solve_normals, prepared.");
}

}  // namespace

void expose_cone(nb::module_& m) {
  expose_block_contacts(m);
  m.def("solve_cone", &solve, "G"_a, "b"_a, "rows"_a, "mu"_a, "lower"_a, "frozen"_a = nb::none(),
        "start"_a = nb::none(), "regularize"_a = true, "noise"_a = 0.0, "accept"_a = kConeTolerance,
        "box"_a = nb::none(),
        "Coulomb cone problem w = b + G lambda of n contacts with rows[i] = 1 or 3 rows (n, t1, t2) each: G (m, m) "
        "[1/kg], b (m,) [m/s], mu (n,), lower (n,) [N s] bounds of the normal impulses, frozen (n, 2) unit slip "
        "directions (NaN: free), start (m,) [N s], noise [m/s] by which rows of b may disagree, accept: residual "
        "below which no other starts are tried, box (n,) [N s] > 0 for rows of joint friction. Returns (lambda (m,) [N "
        "s], ok, relative residual, Newton iterations, "
        "fallbacks).");
  m.def("solve_turning_cone", &solve_turning, "G"_a, "b"_a, "rows"_a, "mu"_a, "rolling"_a, "lower"_a,
        "frozen"_a = nb::none(), "start"_a = nb::none(), "regularize"_a = true,
        "As solve_cone, with spinning and rolling friction: rows[i] = 1 or 3, and one more (spin), two more (roll1, "
        "roll2) or both; rolling (n,) coefficients, 0 without such rows; frozen (n, 5) directions of slip, spin and "
        "rolling (NaN: free).");
  m.def("cone_seconds", &seconds, "G"_a, "b"_a, "rows"_a, "mu"_a, "lower"_a, "frozen"_a = nb::none(),
        "start"_a = nb::none(), "regularize"_a = true, "calls"_a = 100, "repeats"_a = 5, "box"_a = nb::none(),
        "Seconds of one solve_cone, without Python, fastest of several blocks; for benchmarks.");
}

}  // namespace contactvi
