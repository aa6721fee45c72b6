// Scales of rounding that several files share. A threshold that one function alone uses stands beside that function.
#pragma once

namespace contactvi {

// Width of a bracket, relative to its place, below which no number lies inside: two spacings of doubles near 1
// (2 x 2.2e-16). Held by test_parabolas of tests/core/event/test_long_steps.py, whose impacts are
// located to rounding.
constexpr double kNarrowestBracket = 4e-16;

// Fraction of a step below which two places in it are the same. Where a gap is least it varies with the square of the
// distance, and 1e-24 is nothing beside the 1e-12 m to which a gap is located; where it jumps, the jump is located to
// it. Held by test_grazing and test_balls_that_pass_somewhere_in_a_long_step in tests/core/event/test_long_steps.py.
constexpr double kSamePlaceInStep = 1e-12;

// Least number to divide by (in any unit). It only keeps 0/0 out, and every number up to 1e8 divided by it is finite;
// no test comes near it.
constexpr double kLeastDivisor = 1e-300;

// Residual of a cone problem that is solved, relative to the terms of its rows (cone/natural_map.hpp): 4500 spacings of
// doubles, the rounding of a contact matrix with a condition of some thousands. Held by tests/core/cone/test_cone.py.
constexpr double kConeTolerance = 1e-12;

// Of the speeds: slip below it is rounding, and has no direction. Held by tests/core/contact.
constexpr double kStill = 1e-11;

}  // namespace contactvi
