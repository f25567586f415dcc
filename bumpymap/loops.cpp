// The module of the compiled loops of bumpymap.
#include "bumpytiles/bindings.hpp"

NB_MODULE(LOOPS_MODULE, module) { static_cast<void>(module); }
