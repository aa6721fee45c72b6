// Plain doubles: lanes without AVX are slower than one stage after the other.
#include "kernel.hpp"

extern "C" {
extern const contactvi::LaneKernel contactvi_lanes_base[2] = {lane_kernel<double>(), lane_kernel<double>()};
}
