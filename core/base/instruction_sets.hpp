// Functions in plain loops that the compiler makes once for every processor and once for wider vectors; the loader
// takes what the processor has.
#pragma once

// Multiplications and additions are not fused in either, and sums are in the order in which they are written: the
// digits are the same.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__gnu_linux__)
#define CONTACTVI_WIDE_VECTORS __attribute__((target_clones("avx2", "default")))
#else
#define CONTACTVI_WIDE_VECTORS
#endif
