// Persistent contacts of a run as dicts of arrays, in the numbers of the Python API.
#pragma once

#include <nanobind/nanobind.h>

#include <optional>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"
#include "run/run_state.hpp"

namespace contactvi {

enum class GuardKind : int { kContact = 0, kLimit = 1 };

// A guard in the numbers of the Python API: a contact and the number of its pair, or a limit and 2 * joint + upper. No
// guard is a contact of the pair -1.
struct PublicGuard {
  GuardKind kind;
  int index;
};
PublicGuard public_guard(const Scene& s, int guard);

// A momentum or velocity in public coordinates.
VecX public_momentum(const Tree& tree, const VecX& q, VecX p);

Dict impact_rows(const Scene& s, const std::vector<ImpactRecord>& impacts);
// Each is None where there is nothing to report. The lists are moved from.
std::optional<Dict> contact_rows(const Scene& s, const std::vector<ContactRow>& rows);
// Of what lies still: (StillRows, first step, number of steps, start_time, dt, length) of each span.
std::optional<nanobind::list> still_contacts(const std::vector<StillContacts>& spans);
std::optional<Dict> contact_changes(const Scene& s, const std::vector<ChangeRecord>& changes);
std::optional<Dict> step_phases(Recording& recording);
std::optional<Dict> dense_steps(const Scene& s, const Recording& recording);
void expose_still_rows(nanobind::module_& m);
void add_contact_stats(const EngineCounters& counters, const RunState& state, nanobind::dict& d);

}  // namespace contactvi
