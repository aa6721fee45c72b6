// The segments of a finished run: steps and partial steps, row after row.
#pragma once

#include "base/numerics.hpp"

namespace contactvi {

// The arrays belong to the caller. Engine coordinates.
struct SegmentArrays {
  Eigen::Index count;
  const double *t, *h;       // start and length [s]
  const double *q, *p, *p1;  // state at the start, momentum at the end
  const double* rates;       // stage by stage
  const double* persistent;  // 1: with persistent contacts
};

}  // namespace contactvi
