// The kernel's source. The file of each instruction set includes it once; nothing of it is visible outside of that
// file.
#include "lanes.hpp"

namespace {
using namespace contactvi;
#ifdef CONTACTVI_ONE_STAGE
constexpr bool kOneStage = true;  // of all steps: a row of an array is one vector
#else
constexpr bool kOneStage = false;
#endif
// clang-format off: each uses the ones before it
#include "lane_math.hpp"
#include "lane_dynamics.hpp"
#include "lane_factor.hpp"
#include "lane_solve.hpp"
#include "lane_coupled.hpp"
#include "lane_columns.hpp"
#include "lane_newton.hpp"
#include "lane_coupled_factor.hpp"
#include "lane_iteration.hpp"
// clang-format on
}  // namespace
