// A run made before, which tells the next run of the same motion where its steps lead.
#pragma once

#include <vector>

#include "record/recording.hpp"
#include "step/segment_paths.hpp"

namespace contactvi {

// The segments of a recording, as those who read them take them.
SegmentArrays arrays_of(const Segments& segments);
// When the impacts of a recording were [s].
std::vector<double> impact_times(const Recording& recording);

// The stage velocities of a step from the polynomials of the earlier run, moved by what the two runs differ by at the
// start of the step. They miss what the polynomials leave out, far less than the continued polynomial of the step
// before does.
class Guide {
 public:
  // The recording stays the caller's.
  Guide(const Tree& tree, int stages, const Recording& earlier);

  // Velocities at the stages of the step of length h [s] from (q, p) at t [s], (nv, stages); null where the earlier run
  // had no smooth motion. A step beyond the end of a flight is led by the last polynomial of the flight.
  const MatX* lead(double t, double h, const VecX& q, const VecX& p, Integrator& integrator);

 private:
  struct Flight {
    double begin, end;  // [s]
  };
  Flight flight(double time) const;
  bool velocity(double time, const Flight& flight, Integrator& integrator, VecRef v);

  SegmentPaths paths_;
  std::vector<double> impacts_;
  MatX velocities_;
  VecX v_, start_;
};

}  // namespace contactvi
