// AVX-512: four lanes with 32 registers for up to four stages, eight lanes for more.
#include "kernel.hpp"

extern "C" {
extern const contactvi::LaneKernel contactvi_lanes_avx512[2] = {lane_kernel<V4>(), lane_kernel<V8>()};
}
