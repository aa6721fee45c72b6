// A run made before, which tells the next run of the same motion where its steps lead.
#pragma once

#include <array>
#include <vector>

#include "step/segment_arrays.hpp"
#include "step/start_values.hpp"

namespace contactvi {

// The stage velocities of a step from those of the earlier run's steps at the same time, moved by what the two runs
// differ by at the start of the step. They miss what the polynomials of the earlier run leave out, far less than the
// continued polynomial of the step before does.
class Guide {
 public:
  // impacts: times at which the velocity of the earlier run jumps [s], in order.
  Guide(const Tree& tree, const SegmentArrays& earlier, std::vector<double> impacts);

  // Sets the stage velocities of the step of length h [s] from t [s] on; own: the steps of this run before it. False
  // where the earlier run had no smooth motion. A step beyond the end of a flight is led by the last polynomial of the
  // flight.
  bool lead(double t, double h, const StartValues& own, Stages& stages);

 private:
  struct Flight {
    double begin, end;  // [s]
  };
  struct Place {
    Eigen::Index segment;
    double x;  // fraction of the segment
  };
  // The stage velocities of one segment, as Stages keeps them.
  struct Known {
    Eigen::Index segment = -1;
    std::vector<AlignedArray> v;  // one array, or none yet
  };
  static constexpr std::size_t kKnown = 4;  // segments kept at a time: a step lies in two of them, seldom in more

  Flight flight(double time) const;
  bool place(double time, const Flight& flight, Place& place);
  const double* velocities(Eigen::Index segment, const Stages& stages);
  void turn(const Joint& joint, Eigen::Index segment, const Stages& stages, double* v) const;

  const Tree* tree_;
  SegmentArrays segments_;
  std::vector<double> impacts_;
  Eigen::Index cursor_ = 0;  // segment of the last time that was looked for
  std::array<Known, kKnown> known_;
  std::size_t oldest_ = 0;
  std::vector<AlignedArray> weights_;  // one array, or none yet
  VecX difference_;
};

}  // namespace contactvi
