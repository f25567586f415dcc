// The module of the compiled loops of bumpymap.
#include "bumpytiles/bindings.hpp"

void bind_motion_operator(nb::module_& module);
void bind_passable(nb::module_& module);
void bind_rate(nb::module_& module);
void bind_steps(nb::module_& module);

NB_MODULE(LOOPS_MODULE, module) {
    bind_motion_operator(module);
    bind_passable(module);
    bind_rate(module);
    bind_steps(module);
}
