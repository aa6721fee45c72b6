// The contact problems that the steps of a simulator pose, for tests and benchmarks of their solvers.
#include <nanobind/eigen/dense.h>

#include <limits>
#include <utility>
#include <vector>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "run/stepped_world.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

// A number of each contact: (n,).
template <class Contact, class Number>
VecX of_each(const std::vector<Contact>& contacts, Number Contact::* number) {
  VecX values(static_cast<Eigen::Index>(contacts.size()));
  for (Eigen::Index i = 0; i < values.size(); ++i) values[i] = contacts[i].*number;
  return values;
}

template <class Contact>
nb::dict of_contacts(const std::vector<Contact>& contacts, VecX&& start) {
  nb::dict d;
  d["rows"] = hand_over(of_each(contacts, &Contact::rows));
  d["mu"] = hand_over(of_each(contacts, &Contact::mu));
  d["lower"] = hand_over(of_each(contacts, &Contact::lower));
  d["box"] = hand_over(of_each(contacts, &Contact::box));
  d["start"] = hand_over(std::move(start));
  return d;
}

nb::dict of_blocks(ProblemLog::Blocks&& posed) {
  const BlockProblem& p = posed.problem;
  const Eigen::Index n = static_cast<Eigen::Index>(p.contacts.size());
  nb::dict d = of_contacts(p.contacts, std::move(posed.start));
  VecX sizes(p.blocks());
  std::vector<double> masses;
  for (int b = 0; b < p.blocks(); ++b) {
    sizes[b] = p.size(b);
    masses.insert(masses.end(), p.M[b].data(), p.M[b].data() + p.M[b].size());
  }
  Rows blocks(n, 2);
  for (Eigen::Index i = 0; i < n; ++i) blocks.row(i) << p.contacts[i].a, p.contacts[i].b;
  d["sizes"] = hand_over(std::move(sizes));
  d["masses"] = hand_over(std::move(masses));
  d["blocks"] = hand_over(std::move(blocks));
  d["W"] = hand_over(std::vector<double>(p.W));
  d["v_free"] = hand_over(VecX(p.v_free));
  d["offset"] = hand_over(VecX(p.offset));
  d["equations"] = hand_over(Rows(posed.equations));
  d["turning"] = hand_over(of_each(p.contacts, &BlockContact::of));
  d["bound"] = posed.bound;
  return d;
}

nb::dict of_rows(ProblemLog::Rows&& posed) {
  nb::dict d = of_contacts(posed.contacts, std::move(posed.start));
  Rows frozen(static_cast<Eigen::Index>(posed.contacts.size()), 2);
  for (Eigen::Index i = 0; i < frozen.rows(); ++i) {
    frozen.row(i).setConstant(std::numeric_limits<double>::quiet_NaN());
    if (posed.contacts[i].frozen) frozen.row(i) = posed.contacts[i].d.transpose();
  }
  d["frozen"] = hand_over(std::move(frozen));
  d["G"] = hand_over(Rows(posed.G));
  d["b"] = hand_over(std::move(posed.b));
  d["equations"] = posed.equations;
  d["noise"] = posed.noise;
  return d;
}

Dict take_problems(SteppedWorld& sim) {
  nb::list dense, contact;
  for (ProblemLog::Blocks& posed : sim.problems().take_blocks()) dense.append(of_blocks(std::move(posed)));
  for (ProblemLog::Rows& posed : sim.problems().take_rows()) contact.append(of_rows(std::move(posed)));
  nb::dict d;
  d["dense"] = dense;
  d["contact"] = contact;
  return Dict(d);
}

}  // namespace

void expose_posed_problems(nb::class_<SteppedWorld>& simulator) {
  simulator
      .def(
          "keep_problems",
          [](SteppedWorld& sim) {
            if (sim.options().islands && !sim.options().dense)
              throw Error("expected a simulator that advances all bodies together: dense, or without islands");
            sim.keep_problems();
          },
          "From now on the contact problems of steps are kept for take_problems().")
      .def(
          "take_problems", &take_problems,
          "Return the contact problems kept since the last call, in their order: \"dense\", those of dense steps, with "
          "the arguments of BlockContacts, start (rows,) [N s] and bound [J]; \"contact\", those of contact steps, "
          "with "
          "G (m, m), b (m,), start (m,), whose first rows are those of `equations` constraints, then the contacts' "
          "arguments of solve_cone.");
}

}  // namespace contactvi
