// The module of the compiled loops of bumpymap.
#include "bumpytiles/bindings.hpp"

void bind_align(nb::module_& module);
void bind_cells(nb::module_& module);
void bind_deskewing(nb::module_& module);
void bind_ground(nb::module_& module);
void bind_ground_labels(nb::module_& module);
void bind_las(nb::module_& module);
void bind_line_ride(nb::module_& module);
void bind_measure(nb::module_& module);
void bind_merge(nb::module_& module);
void bind_motion_operator(nb::module_& module);
void bind_objects(nb::module_& module);
void bind_pairs(nb::module_& module);
void bind_passable(nb::module_& module);
void bind_point_stats(nb::module_& module);
void bind_polar(nb::module_& module);
void bind_rate(nb::module_& module);
void bind_reach(nb::module_& module);
void bind_search(nb::module_& module);
void bind_solids(nb::module_& module);
void bind_standing(nb::module_& module);
void bind_steps(nb::module_& module);
void bind_straighten(nb::module_& module);

NB_MODULE(LOOPS_MODULE, module) {
    bind_align(module);
    bind_cells(module);
    bind_deskewing(module);
    bind_ground(module);
    bind_ground_labels(module);
    bind_las(module);
    bind_line_ride(module);
    bind_measure(module);
    bind_merge(module);
    bind_motion_operator(module);
    bind_objects(module);
    bind_pairs(module);
    bind_passable(module);
    bind_point_stats(module);
    bind_polar(module);
    bind_rate(module);
    bind_reach(module);
    bind_search(module);
    bind_solids(module);
    bind_standing(module);
    bind_steps(module);
    bind_straighten(module);
}
