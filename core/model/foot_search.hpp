// What the searches for feet on curved surfaces share: damped Newton steps that lessen the square of a distance.
#pragma once

namespace contactvi {

// A step of this length, of the distance and in metres, is the last one: Newton's method doubles the digits.
constexpr double kLast = 1e-9, kLastLength = 1e-11;
// Squares of distances are known to rounding: one that is larger by this part has not grown.
constexpr double kSquareRounding = 1e-13;
constexpr double kFirstDamping = 0.1, kMore = 8.0, kLess = 0.1, kNoDamping = 1e-6;
// Of the distance, and [m]: feet that are no farther from each other are one.
constexpr double kOneFoot = 1e-6, kOneFootLength = 1e-9;

}  // namespace contactvi
