// Laws of contact of single pairs: added once, before any simulator is made.
#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <limits>
#include <optional>
#include <tuple>
#include <utility>
#include <variant>
#include <vector>

#include "base/error.hpp"
#include "bindings/expose.hpp"
#include "bindings/user_functions.hpp"
#include "impact/incremental_impact.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

using Table = std::pair<std::vector<double>, std::vector<double>>;
using OfNumber = nb::typed<nb::callable, double(double)>;
using Address = std::uintptr_t;  // of a C function double(double)
using Given = std::variant<Table, Address, OfNumber>;

std::function<double(double)> function_of(Scene& s, const Given& given) {
  if (const Address* address = std::get_if<Address>(&given))
    return reinterpret_cast<double (*)(double)>(*address);  // NOLINT: the caller says what is there
  return [call = keep(s, std::get<OfNumber>(given))](double place) {
    return guarded(call, std::numeric_limits<double>::quiet_NaN(), [&] { return nb::cast<double>(call(place)); });
  };
}

// Stands for a coefficient of restitution that depends on the speed: neither plastic nor elastic.
constexpr double kVaries = 0.5;

NumberFunction number_function(Scene& s, const std::optional<Given>& value) {
  if (!value) return {};
  if (const Table* table = std::get_if<Table>(&*value)) {
    if (table->first.empty() || table->first.size() != table->second.size())
      throw Error("a table needs as many values as places");
    return {table->first, table->second};
  }
  return NumberFunction(function_of(s, *value));
}

void set_contact_law(Scene& s, const std::vector<int>& pairs, int restitution, bool incremental, bool keeps_energy,
                     double tangential, const std::optional<Given>& e, double spinning, double rolling) {
  ContactLaw law;
  if (restitution < 0 || restitution > 2) throw Error("there is no such law of restitution");
  law.restitution = static_cast<RestitutionLaw>(restitution);
  law.incremental = incremental;
  law.keeps_energy = keeps_energy;
  law.tangential = tangential;
  law.spinning = spinning;
  law.rolling = rolling;
  law.e = number_function(s, e);
  for (const int pair : pairs) {
    if (pair < 0 || pair >= static_cast<int>(s.pairs.size())) throw Error("there is no such pair");
    Pair& taken = s.pairs[static_cast<std::size_t>(pair)];
    taken.law = static_cast<int>(s.laws.size());
    if (law.e.given()) taken.restitution = kVaries;
  }
  s.laws.push_back(std::move(law));
}

void set_surface_motion(Scene& s, int geometry, const Vec3& linear, const Vec3& angular,
                        const std::optional<Given>& profile) {
  if (geometry < 0 || geometry >= static_cast<int>(s.geometries.size())) throw Error("there is no such geometry");
  s.geometries[static_cast<std::size_t>(geometry)].motion = static_cast<int>(s.surface_motions.size());
  s.surface_motions.push_back({linear, angular, number_function(s, profile)});
  for (Pair& pair : s.pairs) pair.moves |= pair.a == geometry || pair.b == geometry;
}

}  // namespace

void expose_laws(nb::module_& m, nb::class_<Scene>& scene) {
  scene.def(
      "set_contact_law", &set_contact_law, "pairs"_a, "restitution"_a, "incremental"_a, "keeps_energy"_a,
      "tangential"_a, "e"_a.none(), "spinning"_a, "rolling"_a,
      "Gives pairs a law of restitution (0 Poisson, 1 Newton, 2 energetic), whether an impact of one point is "
      "followed through its impulse, whether e is lowered so that no energy is made, tangential restitution, and e "
      "as a function of the closing speed (table, address of a C function, function) or None; radii [m] of the "
      "friction against spinning and rolling.");
  scene.def(
      "set_surface_motion", &set_surface_motion, "geometry"_a, "linear"_a, "angular"_a, "profile"_a.none(),
      "Lets the surface of a geometry move along itself: linear and angular velocity in its frame, and a factor by "
      "the time (table, address of a C function, function) or None.");
  m.def(
      "follow_impact",
      [](const Mat3& G, const Vec3& w, double mu, double e, int law) {
        const IncrementalImpact impact = follow_impact(G, w, mu, e, static_cast<RestitutionLaw>(law));
        return std::tuple<bool, Vec3, Vec3>(impact.ok, impact.lambda, impact.compression);
      },
      "G"_a, "w"_a, "mu"_a, "e"_a, "law"_a,
      "Impulse (n, t1, t2) of one point by the incremental law, and that until the end of the compression: (ok, (3,), "
      "(3,)).");
}

}  // namespace contactvi
