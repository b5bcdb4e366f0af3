#pragma once
// One binary for every x86-64: the loader picks the version of a function that the processor runs. Only speed depends on it:
// without fused multiply-add (-ffp-contract=off) the versions compute the same bits.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define SHADELAB_CLONES __attribute__((noinline, flatten, target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define SHADELAB_CLONES __attribute__((noinline))
#endif
