// Pinocchio's own algorithms for comparison in benchmarks/, timed in C++ without Python in the loop.
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <pinocchio/multibody.hpp>

#include <nanobind/eigen/dense.h>

#include <chrono>

#include "base/error.hpp"
#include "base/numerics.hpp"
#include "bindings/expose.hpp"
#include "model/archive.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

pinocchio::Model unpack(nb::bytes archive, const VecX& q, const VecX& v) {
  pinocchio::Model model;
  read_model({archive.c_str(), archive.size()}, model);
  if (q.size() != model.nq || v.size() != model.nv) throw Error("expected shapes (nq,) and (nv,)");
  return model;
}

// Seconds per call, of the fastest of several blocks.
template <class Call>
double fastest(int calls, int repeats, Call call) {
  double best = INFINITY;
  for (int r = 0; r < repeats; ++r) {
    const auto start = std::chrono::steady_clock::now();
    for (int k = 0; k < calls; ++k) call();
    best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() / calls);
  }
  return best;
}

double rnea_seconds(nb::bytes archive, const VecX& q, const VecX& v, int calls, int repeats) {
  const pinocchio::Model model = unpack(archive, q, v);
  pinocchio::Data data(model);
  const VecX a = VecX::Ones(model.nv);
  return fastest(calls, repeats, [&] { pinocchio::rnea(model, data, q, v, a); });
}

double aba_seconds(nb::bytes archive, const VecX& q, const VecX& v, int calls, int repeats) {
  const pinocchio::Model model = unpack(archive, q, v);
  pinocchio::Data data(model);
  const VecX tau = VecX::Ones(model.nv);
  return fastest(calls, repeats, [&] { pinocchio::aba(model, data, q, v, tau, pinocchio::Convention::LOCAL); });
}

}  // namespace

void expose_reference(nb::module_& m) {
  m.def("rnea_seconds", &rnea_seconds, "model"_a, "q"_a, "v"_a, "calls"_a = 2000, "repeats"_a = 5,
        "Seconds per pinocchio::rnea, fastest of several blocks; for benchmarks.");
  m.def("aba_seconds", &aba_seconds, "model"_a, "q"_a, "v"_a, "calls"_a = 2000, "repeats"_a = 5,
        "Seconds per pinocchio::aba, fastest of several blocks; for benchmarks.");
}

}  // namespace contactvi
