// Eight runs, whose steps have one stage each.
#define CONTACTVI_ONE_STAGE
#include "kernel.hpp"

extern "C" {
extern const contactvi::RunKernel contactvi_runs_avx512 = run_kernel<V8>();
}
