// The module of the compiled loops of bumpytiles.
#include "bumpytiles/bindings.hpp"

void bind_grouping(nb::module_& module);

namespace {

// True if this processor has what the second build asks of it: x86-64-v3, in all x86-64 processors since about 2013.
bool runs_v3() {
#ifdef __x86_64__
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
           __builtin_cpu_supports("bmi2");
#else
    return false;
#endif
}

}  // namespace

NB_MODULE(LOOPS_MODULE, module) {
    module.def("runs_v3", &runs_v3);
    bind_grouping(module);
}
