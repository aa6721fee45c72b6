"""A library to preload that counts the calls of malloc, as C text, for tests that something allocates nothing."""

SHIM = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stddef.h>
static void *(*real_malloc)(size_t);
static void *(*real_aligned)(size_t, size_t);
static long calls;
void *malloc(size_t size) {
    if (!real_malloc) real_malloc = (void *(*)(size_t))dlsym(RTLD_NEXT, "malloc");
    __atomic_add_fetch(&calls, 1, __ATOMIC_RELAXED);
    return real_malloc(size);
}
void *aligned_alloc(size_t alignment, size_t size) {
    if (!real_aligned) real_aligned = (void *(*)(size_t, size_t))dlsym(RTLD_NEXT, "aligned_alloc");
    __atomic_add_fetch(&calls, 1, __ATOMIC_RELAXED);
    return real_aligned(alignment, size);
}
long malloc_calls(void) { return calls; }
"""
