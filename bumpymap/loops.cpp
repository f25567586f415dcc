// The module of the compiled loops of bumpymap: those of each source that is named here.
#include "bumpytiles/bindings.hpp"

#define BUMPY_SOURCES                                                                                                 \
    align, cells, deskewing, ground_power, jumps, las, line_ride, measure, merge, motion_operator, objects, passable, \
        point_stats, rate, search, sectors, solids, standing, steps

#define DECLARE(name) void bind_##name(nb::module_& module);
BUMPY_EACH(DECLARE, BUMPY_SOURCES)

#define BIND(name) bind_##name(module);
NB_MODULE(LOOPS_MODULE, module) { BUMPY_EACH(BIND, BUMPY_SOURCES) }
