// AVX2: eight stages are two groups of four lanes.
#include "kernel.hpp"

extern "C" {
extern const contactvi::LaneKernel contactvi_lanes_avx2[2] = {lane_kernel<V4>(), lane_kernel<V4>()};
}
