// The module of the compiled loops of bumpymap.
#include "bumpytiles/bindings.hpp"

void bind_measure(nb::module_& module);
void bind_objects(nb::module_& module);
void bind_pairs(nb::module_& module);
void bind_solids(nb::module_& module);
void bind_standing(nb::module_& module);

NB_MODULE(LOOPS_MODULE, module) {
    bind_measure(module);
    bind_objects(module);
    bind_pairs(module);
    bind_solids(module);
    bind_standing(module);
}
