// The impacts that are possible at one configuration, without friction: single ones, and the sequence that a run takes.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <memory>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "impact/sequence.hpp"
#include "model/coordinates.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

// Momenta are in engine coordinates throughout; contacts are numbered as they were given.
class ImpactsAt {
 public:
  ImpactsAt(const Scene& scene, const VecX& q, const std::vector<int>& guards, const VecX& restitution, double margin,
            long max_impacts)
      : scene_(frictionless(scene, guards, restitution)),
        integrator_(scene_.tree, 1, 1e-12, 1),
        guards_(scene_),
        q_(q) {
    options_.max_impacts_per_step = max_impacts;
    options_.record_contacts = false;
    if (q.size() != scene_.tree.nq) throw Error("expected shape (nq,)");
    every_ = closed(guards, margin);
    for (int g : guards) alone_.push_back(closed({g}, margin));
  }

  // d(gap)/dq of the points of a contact in public coordinates, (points, nv).
  Rows gradients(int contact) {
    const ClosedGuard& c = at(contact);
    Rows W(c.count, scene_.tree.nv);
    MatX row(scene_.tree.nv, 1);
    guards_.place(q_);
    for (int i = 0; i < c.count; ++i) {
      guards_.rows(c.guard, c.contacts[i], c.t1[i], row);
      engine_to_public(scene_.tree, q_, row.col(0));
      W.row(i) = row.col(0).transpose();
    }
    return W;
  }

  // The directions in which the momentum changes, (points, nv), engine coordinates: constraints answer at once.
  Rows directions(int contact) const { return at(contact).W.leftCols(at(contact).rows).transpose(); }

  // One impact of one contact with its own e; the momentum after, and the sum of the impulses of its points [N s].
  auto strike(int contact, const VecX& p) {
    if (contact < 0 || contact >= count()) throw Error("there is no such contact");
    Recording recording;
    VecX after = p;
    play(*alone_[contact], {}, after, recording);
    double impulse = 0.0;
    for (const ImpactRecord& r : recording.impacts) impulse += r.impulse;
    return std::make_tuple(after, impulse);
  }

  // All contacts as one plastic problem: (momentum after, impulses (n,)).
  auto settle(const VecX& p) {
    Recording recording;
    VecX after = p;
    play(*every_, std::vector<char>(scene_.guard_count(), 1), after, recording);
    return std::make_tuple(after, impulses(recording));
  }

  // What a run does: (momentum after, impulses (n,), the contacts struck as one in their order, whether it ended within
  // max_impacts, whether contacts with e > 0 ended plastically).
  auto run(const VecX& p) {
    Recording recording;
    VecX after = p;
    const bool ended = play(*every_, {}, after, recording);
    std::vector<std::vector<int>> struck;
    bool cut = false, together = false;
    for (const ImpactRecord& r : recording.impacts) {
      const int contact = number(r.guard);
      const bool plastic = r.restitution == 0.0;
      cut |= plastic && at(contact).e > 0.0;
      // The members of a plastic problem are recorded in ascending order.
      if (plastic && together && struck.back().back() < contact)
        struck.back().push_back(contact);
      else
        struck.push_back({contact});
      together = plastic;
    }
    return std::make_tuple(after, impulses(recording), struck, ended, cut);
  }

 private:
  static Scene frictionless(const Scene& scene, const std::vector<int>& guards, const VecX& restitution) {
    if (restitution.size() != static_cast<Eigen::Index>(guards.size())) throw Error("expected one e per contact");
    Scene changed = scene;
    for (Pair& pair : changed.pairs) pair.friction = 0.0;
    for (std::size_t k = 0; k < guards.size(); ++k) {
      const int g = guards[k];
      if (g < 0 || g >= scene.guard_count()) throw Error("there is no such guard");
      if (scene.is_pair(g))
        changed.pairs[g].restitution = restitution[k];
      else
        changed.tree.limits[g - static_cast<int>(scene.pairs.size())].restitution = restitution[k];
    }
    return changed;
  }

  std::unique_ptr<ImpactSequence> closed(const std::vector<int>& guards, double margin) {
    auto made = std::make_unique<ImpactSequence>(scene_, integrator_, guards_, options_);
    if (!made->collect_given(q_, VecX::Zero(scene_.tree.nv), 0.0, guards, margin)) throw Error(made->message());
    return made;
  }

  int count() const { return static_cast<int>(alone_.size()); }
  const ClosedGuard& at(int contact) const {
    if (contact < 0 || contact >= count()) throw Error("there is no such contact");
    return every_->closed(contact);
  }
  int number(int guard) const {
    for (int i = 0; i < count(); ++i)
      if (every_->closed(i).guard == guard) return i;
    throw Error("an impact of a contact that is not closed");
  }
  VecX impulses(const Recording& recording) const {
    VecX sums = VecX::Zero(count());
    for (const ImpactRecord& r : recording.impacts) sums[number(r.guard)] += r.impulse;
    return sums;
  }

  // False where the impacts allowed were not enough.
  bool play(ImpactSequence& sequence, std::vector<char> plastic, VecX& p, Recording& recording) {
    if (p.size() != scene_.tree.nv) throw Error("expected shape (nv,)");
    if (plastic.empty()) plastic.assign(scene_.guard_count(), 0);
    const VecX none;
    ImpactReference reference;
    sequence.begin_step();
    if (sequence.run({0.0, 0.0, 0.0, 0.0, none, 0, &integrator_}, plastic, reference, p, recording)) return true;
    if (sequence.code() != StatusCode::kTooManyImpacts) throw Error(sequence.message());
    return false;
  }

  Scene scene_;
  Integrator integrator_;
  Guards guards_;
  VecX q_;
  ImpactOptions options_;
  std::unique_ptr<ImpactSequence> every_;               // all contacts closed
  std::vector<std::unique_ptr<ImpactSequence>> alone_;  // one of them closed
};

}  // namespace

void expose_sequence(nb::module_& m) {
  nb::class_<ImpactsAt>(m, "ImpactsAt")
      .def(nb::init<const Scene&, const VecX&, const std::vector<int>&, const VecX&, double, long>(), "scene"_a, "q"_a,
           "guards"_a, "restitution"_a, "margin"_a, "max_impacts"_a,
           "Frictionless impacts of these guards at q, taken as closed; momenta are in engine coordinates.")
      .def("gradients", &ImpactsAt::gradients, "contact"_a,
           "d(gap)/dq of its points, public coordinates, (points, nv).")
      .def("directions", &ImpactsAt::directions, "contact"_a,
           "What an impulse at each of its points adds to the momentum, constraints included, (points, nv).")
      .def("strike", &ImpactsAt::strike, "contact"_a, "p"_a, "(momentum after one impact, sum of its impulses [N s]).")
      .def("settle", &ImpactsAt::settle, "p"_a, "All contacts as one plastic problem: (momentum after, impulses (n,)).")
      .def("run", &ImpactsAt::run, "p"_a,
           "The sequence that a run takes: (momentum after, impulses (n,), contacts struck as one, whether it ended, "
           "whether elastic contacts ended plastically).");
}

}  // namespace contactvi
