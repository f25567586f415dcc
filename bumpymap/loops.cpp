// The module of the compiled loops of bumpymap.
#include "bumpytiles/bindings.hpp"

void bind_measure(nb::module_& module);

NB_MODULE(LOOPS_MODULE, module) { bind_measure(module); }
