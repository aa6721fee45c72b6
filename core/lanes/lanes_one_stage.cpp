// Steps with one stage, on plain doubles: loops over stages and products with the length of a row are gone.
#define CONTACTVI_ONE_STAGE
#include "kernel.hpp"

extern "C" {
extern const contactvi::LaneKernel contactvi_lanes_one_stage = lane_kernel<double>();
}
