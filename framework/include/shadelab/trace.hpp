#pragma once
// For plugins with -DSHADELAB_TRACE and g++ -fsanitize-coverage=trace-cmp: what the student's code compares goes to whoever asks.

#include <shadelab/plugin.hpp>

namespace shadelab::plugin {
inline void trace_nothing(const void*, double, double) {}
}  // namespace shadelab::plugin

extern "C" {
// Always called, never compared with null: that comparison would be traced, too.
__attribute__((visibility("default"))) shadelab::plugin::Trace shadelab_trace = shadelab::plugin::trace_nothing;

#define SHADELAB_TRACED(name, type, number)                                \
    void __sanitizer_cov_trace_##name(type a, type b) {                    \
        shadelab_trace(__builtin_return_address(0), number(a), number(b)); \
    }
SHADELAB_TRACED(cmpf, float, double)
SHADELAB_TRACED(cmpd, double, double)
SHADELAB_TRACED(cmp4, unsigned, int)
SHADELAB_TRACED(const_cmp4, unsigned, int)
#undef SHADELAB_TRACED

// Of other types nothing is asked: no argument has them.
#define SHADELAB_UNTRACED(name, type) \
    void __sanitizer_cov_trace_##name(type, type) {}
SHADELAB_UNTRACED(cmp1, unsigned char)
SHADELAB_UNTRACED(const_cmp1, unsigned char)
SHADELAB_UNTRACED(cmp2, unsigned short)
SHADELAB_UNTRACED(const_cmp2, unsigned short)
SHADELAB_UNTRACED(cmp8, unsigned long)
SHADELAB_UNTRACED(const_cmp8, unsigned long)
#undef SHADELAB_UNTRACED
void __sanitizer_cov_trace_switch(unsigned long, unsigned long*) {}
}
