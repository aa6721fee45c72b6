// What a run says of held contacts, as dicts of arrays in public numbers.
#pragma once

#include <nanobind/nanobind.h>

#include <utility>

#include "run/simulator.hpp"

namespace contactvi {

// The numbers of a guard on the Python side: kind 0 and the pair, or kind 1 and 2 * joint + upper.
std::pair<int, int> public_guard(const Scene& s, int guard);

// None where there is nothing. The lists are moved from.
nanobind::object contact_rows(const Scene& s, ContactRows& rows);
nanobind::object contact_changes(const Scene& s, const std::vector<ChangeRecord>& changes);
nanobind::object step_phases(Recording& recording);
void add_contact_stats(const Simulator& sim, nanobind::dict& d);

}  // namespace contactvi
