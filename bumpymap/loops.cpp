// The module of the compiled loops of bumpymap.
#include "bumpytiles/bindings.hpp"

void bind_deskew(nb::module_& module);
void bind_las(nb::module_& module);
void bind_point_stats(nb::module_& module);

NB_MODULE(LOOPS_MODULE, module) {
    bind_deskew(module);
    bind_las(module);
    bind_point_stats(module);
}
