// Runs one after the other, whose steps have one stage each.
#define CONTACTVI_ONE_STAGE
#include "kernel.hpp"

extern "C" {
extern const contactvi::RunKernel contactvi_runs_base = run_kernel<double>();
}
