// The module of the compiled loops of bumpymap.
#include "bumpytiles/bindings.hpp"

void bind_align(nb::module_& module);
void bind_cells(nb::module_& module);
void bind_ground(nb::module_& module);
void bind_ground_labels(nb::module_& module);
void bind_merge(nb::module_& module);
void bind_polar(nb::module_& module);

NB_MODULE(LOOPS_MODULE, module) {
    bind_align(module);
    bind_cells(module);
    bind_ground(module);
    bind_ground_labels(module);
    bind_merge(module);
    bind_polar(module);
}
