// Scene: energies, momenta, gaps and single steps, in public coordinates unless documented otherwise.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "bindings/user_calls.hpp"
#include "geometry/guard.hpp"
#include "geometry/prepare.hpp"
#include "model/coordinates.hpp"
#include "model/flat_model.hpp"
#include "model/public_model.hpp"
#include "model/rounding.hpp"
#include "step/energy.hpp"
#include "step/integrator.hpp"
#include "step/lost_velocity.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

int stages_of(int order) {
  need(order >= 2 && order <= 2 * kMaxStages && order % 2 == 0, "expected an even order from 2 to 16");
  return order / 2;
}

void need_state(const Scene& s, const VecX& q, const VecX& w) {
  need(q.size() == s.tree.nq && w.size() == s.tree.nv, "expected shapes (nq,) and (nv,)");
}

void need_states(const Scene& s, const Rows& q, const Rows& w) {
  need(q.cols() == s.tree.nq && w.cols() == s.tree.nv && q.rows() == w.rows(), "expected shapes (N, nq) and (N, nv)");
}

using Vertices = decltype(Polytope::vertices);
using Faces = decltype(Polytope::faces);

// Rounded hulls that an object of Python keeps: its find(vertices, faces, radius) returns (vertices, faces, radius) or
// None, its keep(vertices, faces, radius, vertices, faces, radius) takes a hull and its shrunk one.
class KeptRoundedHulls : public RoundedHulls {
 public:
  explicit KeptRoundedHulls(nb::object keeper) : keeper_(std::move(keeper)) {}

  std::optional<ShrunkHull> find(const Polytope& hull, double radius) override {
    const nb::object found = keeper_.attr("find")(nb::cast(hull.vertices), nb::cast(hull.faces), radius);
    if (found.is_none()) return std::nullopt;
    const auto [vertices, faces, shrunk] = nb::cast<std::tuple<Vertices, Faces, double>>(found);
    need(faces.size() > 0 && faces.minCoeff() >= 0 && faces.maxCoeff() < vertices.rows() && shrunk >= 0.0,
         "expected the vertices and triangles of a hull, and a radius");
    return ShrunkHull{{vertices, faces}, shrunk};
  }

  void keep(const Polytope& hull, double radius, const ShrunkHull& made) override {
    keeper_.attr("keep")(nb::cast(hull.vertices), nb::cast(hull.faces), radius, nb::cast(made.hull.vertices),
                         nb::cast(made.hull.faces), made.radius);
  }

 private:
  nb::object keeper_;
};

// Of each geometry its joint, its placement there, its name, and the address of its shape, the id() of coal's object.
using ShapeRows = std::vector<std::tuple<int, Mat3, Vec3, std::string, std::uintptr_t>>;

std::vector<GivenShape> shapes_of(ShapeRows&& rows) {
  std::vector<GivenShape> shapes;
  for (auto& [joint, R, p, name, address] : rows)
    shapes.push_back({joint, R, p, std::move(name), reinterpret_cast<const coal::CollisionGeometry*>(address)});
  return shapes;
}

// Raises what a function of the user raised while the engine called it.
void raise_user_errors(const Scene& s) {
  s.tree.elements.forget_failure();
  UserErrors::raise();
}

Array2 velocity(const Scene& s, const Rows& q, const Rows& p) {
  need_states(s, q, p);
  Integrator integrator(s.tree, 1, 1e-12, 1);
  Rows v(p.rows(), p.cols());
  VecX w(s.tree.nv);
  for (Eigen::Index i = 0; i < q.rows(); ++i) {
    const VecX qi = q.row(i);
    VecX pi = p.row(i);
    public_to_engine(s.tree, qi, pi);
    if (!integrator.node_velocity(qi, pi, w)) w.setConstant(std::numeric_limits<double>::quiet_NaN());
    engine_to_public(s.tree, qi, w);
    v.row(i) = w;
  }
  return hand_over(std::move(v));
}

Array2 momentum(const Scene& s, const Rows& q, const Rows& v) {
  need_states(s, q, v);
  Integrator integrator(s.tree, 1, 1e-12, 1);
  Rows p(v.rows(), v.cols());
  VecX P(s.tree.nv), G(s.tree.nv);
  for (Eigen::Index i = 0; i < q.rows(); ++i) {
    const VecX qi = q.row(i);
    VecX vi = v.row(i);
    public_to_engine(s.tree, qi, vi);
    integrator.dynamics(qi, vi, P, G);
    engine_to_public(s.tree, qi, P);
    p.row(i) = P;
  }
  return hand_over(std::move(p));
}

Array2 energies(const Scene& s, const Rows& q, const Rows& p) {
  need_states(s, q, p);
  Integrator integrator(s.tree, 1, 1e-12, 1);
  Rows result(q.rows(), 2);
  for (Eigen::Index i = 0; i < q.rows(); ++i) {
    const VecX qi = q.row(i);
    VecX pi = p.row(i);
    public_to_engine(s.tree, qi, pi);
    const Energy e = energy(integrator, qi, pi);
    result.row(i) << e.kinetic, e.potential;
  }
  raise_user_errors(s);
  return hand_over(std::move(result));
}

Array1 modified_energies(const Scene& s, const Rows& q, const Rows& p, double h, int order, std::optional<VecX> t) {
  need_states(s, q, p);
  if (t && t->size() != q.rows()) throw Error("expected t of shape (N,)");
  Integrator integrator(s.tree, stages_of(order), 1e-12, 1);
  VecX result(q.rows());
  for (Eigen::Index i = 0; i < q.rows(); ++i) {
    const VecX qi = q.row(i);
    VecX pi = p.row(i);
    public_to_engine(s.tree, qi, pi);
    result[i] = modified_hamiltonian(integrator, qi, pi, h, t ? (*t)[i] : 0.0);
  }
  raise_user_errors(s);
  return hand_over(std::move(result));
}

// E_d of steps h[i] from (q[i], p[i]); a negative h stands for the step that ended there.
Array1 discrete_energies(const Scene& s, const Rows& q, const Rows& p, const VecX& h, int order) {
  need_states(s, q, p);
  need(h.size() == q.rows(), "expected one step length per state");
  Integrator integrator(s.tree, stages_of(order), 1e-13, 100);
  VecX result(q.rows());
  for (Eigen::Index i = 0; i < q.rows(); ++i) {
    const VecX qi = q.row(i);
    VecX pi = p.row(i);
    public_to_engine(s.tree, qi, pi);
    integrator.forget();
    result[i] = integrator.solve(qi, pi, h[i], VecX()) ? integrator.discrete_energy()
                                                       : std::numeric_limits<double>::quiet_NaN();
  }
  raise_user_errors(s);
  return hand_over(std::move(result));
}

// Total momentum, linear (world frame) and angular about the world's origin, (N, 6).
Array2 spatial_momenta(const Scene& s, const Rows& q, const Rows& p) {
  need_states(s, q, p);
  Integrator integrator(s.tree, 1, 1e-12, 1);
  Rows result = Rows::Zero(q.rows(), 6);
  VecX v(s.tree.nv);
  for (Eigen::Index i = 0; i < q.rows(); ++i) {
    const VecX qi = q.row(i);
    VecX pi = p.row(i);
    public_to_engine(s.tree, qi, pi);
    if (!integrator.node_velocity(qi, pi, v)) v.setConstant(std::numeric_limits<double>::quiet_NaN());
    result.row(i) = spatial_momentum(s.tree, qi, v).transpose();
  }
  return hand_over(std::move(result));
}

auto dynamics(const Scene& s, const VecX& q, const VecX& v) {
  need_state(s, q, v);
  Integrator integrator(s.tree, 1, 1e-12, 1);
  VecX P(s.tree.nv), G(s.tree.nv);
  integrator.dynamics(q, v, P, G);
  return std::make_tuple(P, G);
}

auto step(const Scene& s, const VecX& q, const VecX& p, double h, std::optional<VecX> tau, double tol, int order) {
  need_state(s, q, p);
  need(!tau || tau->size() == s.tree.nv, "tau: expected shape (nv,)");
  Integrator integrator(s.tree, stages_of(order), tol, 100);
  VecX p0 = p, q1(s.tree.nq), p1(s.tree.nv);
  public_to_engine(s.tree, q, p0);
  if (!integrator.solve(q, p0, h, tau ? *tau : VecX())) throw Error(integrator.why());
  integrator.finish(q1, p1);
  engine_to_public(s.tree, q1, p1);
  const Rows v = integrator.velocities().transpose();
  return std::make_tuple(q1, p1, v, integrator.stage_iterations(), integrator.residual_norm());
}

auto gaps(const Scene& s, const VecX& q) {
  need(q.size() == s.tree.nq, "expected shape (nq,)");
  Guards guards(s);
  guards.place(q);
  const Eigen::Index n = static_cast<Eigen::Index>(s.pairs.size());
  VecX gap(n);
  Rows normal(n, 3), a(n, 3), b(n, 3);
  for (Eigen::Index i = 0; i < n; ++i) {
    Contact c;
    gap[i] = guards.evaluate(static_cast<int>(i), c);
    normal.row(i) = c.normal;
    a.row(i) = c.point_a;
    b.row(i) = c.point_b;
  }
  raise_user_errors(s);
  return std::make_tuple(gap, normal, a, b);
}

Array2 gaps_along(const Scene& s, const Rows& q, const IntVec& pairs) {
  need(q.cols() == s.tree.nq, "expected shape (n, nq)");
  const std::int64_t count = static_cast<std::int64_t>(s.pairs.size());
  need(pairs.size() == 0 || (pairs.minCoeff() >= 0 && pairs.maxCoeff() < count), "expected indices of pairs");
  Rows gap(q.rows(), pairs.size());
  {
    nb::gil_scoped_release release;
    Guards guards(s);
    Contact unused;
    for (Eigen::Index k = 0; k < q.rows(); ++k) {
      guards.place(q.row(k).transpose());
      for (Eigen::Index i = 0; i < pairs.size(); ++i) gap(k, i) = guards.evaluate(static_cast<int>(pairs[i]), unused);
    }
  }
  raise_user_errors(s);
  return hand_over(std::move(gap));
}

Rows gap_gradients(const Scene& s, const VecX& q) {
  need(q.size() == s.tree.nq, "expected shape (nq,)");
  Guards guards(s);
  guards.place(q);
  Rows W(guards.count(), s.tree.nv);
  VecX row(s.tree.nv);
  for (int g = 0; g < guards.count(); ++g) {
    Contact c;
    guards.evaluate(g, c);
    guards.gradient(g, c, row);
    engine_to_public(s.tree, q, row);  // it is a covector, dual to v as a momentum is
    W.row(g) = row;
  }
  raise_user_errors(s);
  return W;
}

template <void (*convert)(const Tree&, const VecCRef&, VecRef)>
VecX converted(const Scene& s, const VecX& q, const VecX& w) {
  need_state(s, q, w);
  VecX result = w;
  convert(s.tree, q, result);
  return result;
}

}  // namespace

void expose_scene(nb::module_& m) {
  nb::class_<Scene> scene(m, "Scene", nb::type_slots(scene_slots));
  scene
      .def(
          "__init__",
          // Values of pairs are moved and not copied: those of a large scene take megabytes.
          [](Scene* self, const PublicModel& model, ShapeRows shapes, const GeometryPairs& pairs, VecX pair_restitution,
             VecX pair_friction, const VecX& stiffness, const VecX& rest, const VecX& damping, const VecX& limits,
             const VecX& limit_restitution, nb::object rounded_hulls) {
            instruction_set();  // a wrong name in the environment is refused before anything is computed
            KeptRoundedHulls known(rounded_hulls);
            Scene scene = load_scene(std::make_shared<const PublicModel>(model), shapes_of(std::move(shapes)), pairs,
                                     {std::move(pair_restitution), std::move(pair_friction), stiffness, rest, damping,
                                      limits, limit_restitution},
                                     rounded_hulls.is_none() ? nullptr : &known);
            prepare_geometry(scene);
            new (self) Scene(std::move(scene));
          },
          "model"_a, "shapes"_a, "pairs"_a, "pair_restitution"_a, "pair_friction"_a, "stiffness"_a, "rest"_a,
          "damping"_a, "limits"_a, "limit_restitution"_a, "rounded_hulls"_a = nb::none(),
          "shapes: of each geometry its joint (0: the world), rotation and position there, name, and the id() of its "
          "shape of coal, which is copied; pairs: numbers of two geometries in each row; "
          "rounded_hulls: keeps rounded hulls from one process to the next, has find and keep.")
      .def_prop_ro(
          "model", [](const Scene& s) -> const PublicModel& { return *s.model; }, nb::rv_policy::reference_internal)
      .def_prop_ro("nq", [](const Scene& s) { return s.tree.nq; })
      .def_prop_ro("nv", [](const Scene& s) { return s.tree.nv; })
      .def_prop_ro("njoints", [](const Scene& s) { return s.tree.body_of_source.size(); })
      .def_prop_ro("npairs", [](const Scene& s) { return s.pairs.size(); })
      .def_prop_ro(
          "calls_functions", [](const Scene& s) { return s.tree.elements.functions != nullptr; },
          "Whether it calls functions of the user.")
      .def_prop_ro(
          "rounding",
          [](const Scene& s) {
            std::vector<double> r;
            for (const Pair& pair : s.pairs)
              r.push_back(pair.rounded ? std::max(s.geometries[pair.a].rounding, s.geometries[pair.b].rounding) : 0.0);
            return r;
          },
          "Rounding radius [m] of each pair's shapes, 0 where they are sharp.")
      .def("velocity", &velocity, "q"_a, "p"_a, "v = M(q)^-1 p, shapes (N, nq), (N, nv) -> (N, nv).")
      .def(
          "lost_velocity",
          [](const Scene& s, const VecX& q) {
            if (q.size() != s.tree.nq) throw Error("expected shape (nq,)");
            Integrator integrator(s.tree, 1, 1e-12, 1);
            const LostVelocity lost = lost_velocity(integrator, q);
            return std::make_pair(lost.dof, lost.share);
          },
          "q"_a,
          "(dof, share): of a velocity of size one at q (nq,) that becomes a momentum and a velocity again, where most "
          "is lost, and how much.")
      .def("momentum", &momentum, "q"_a, "v"_a, "p = M(q) v, shapes (N, nq), (N, nv) -> (N, nv).")
      .def("energy", &energies, "q"_a, "p"_a, "Kinetic and potential energy [J], (N, 2).")
      .def("modified_energy", &modified_energies, "q"_a, "p"_a, "h"_a, "order"_a = 2, "t"_a = nb::none(),
           "Modified Hamiltonian [J] for step h, (N,); H for order >= 4. t (N,): of the states, for constraints.")
      .def("discrete_energy", &discrete_energies, "q"_a, "p"_a, "h"_a, "order"_a = 2,
           "E_d [J] of one step h (N,) from each state, (N,).")
      .def("spatial_momentum", &spatial_momenta, "q"_a, "p"_a,
           "Total linear, angular momentum about the origin, (N, 6).")
      .def("dynamics", &dynamics, "q"_a, "v"_a, "(M v, dT/dq - dV/dq of gravity) in engine coordinates.")
      .def(
          "step", &step, "q"_a, "p"_a, "h"_a, "tau"_a = nb::none(), "tol"_a = 1e-12, "order"_a = 2,
          "One smooth step without contact: (q1, p1, stage velocities (s, nv) in engine coordinates, stage iterations, "
          "residual).")
      .def("gaps", &gaps, "q"_a, "(gap (npairs,), normal, point_a, point_b (npairs, 3)), world frame.")
      .def("gaps_along", &gaps_along, "q"_a, "pairs"_a,
           "Gaps of some pairs (k,) at configurations (n, nq), shape (n, k) [m].")
      .def("gap_gradients", &gap_gradients, "q"_a, "d(gap)/dq of all guards, pairs then limits, (nguards, nv).")
      .def("to_engine", &converted<public_to_engine>, "q"_a, "v"_a)
      .def("to_public", &converted<engine_to_public>, "q"_a, "v"_a)
      .def("momentum_to_engine", &converted<public_to_engine>, "q"_a, "p"_a)
      .def("momentum_to_public", &converted<engine_to_public>, "q"_a, "p"_a);
  expose_elements(scene);
  expose_laws(m, scene);
}

}  // namespace contactvi
