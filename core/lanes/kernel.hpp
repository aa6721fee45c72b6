// The kernel's source, to be included once by the file of each instruction set, nothing else of it being visible
// outside.
#include "lanes.hpp"

namespace {
using namespace contactvi;
// clang-format off: each stands on the one before
#include "lane_math.hpp"
#include "lane_dynamics.hpp"
#include "lane_factor.hpp"
#include "lane_solve.hpp"
#include "lane_newton.hpp"
#include "lane_sweep.hpp"
// clang-format on
}  // namespace
