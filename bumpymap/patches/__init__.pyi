from .cloth import (
    close_filter as close_filter,
    filter_version as filter_version,
    mark_ground as mark_ground,
    require_filter as require_filter,
)
from .features import (
    choose_tiles as choose_tiles,
    decks_as_ground as decks_as_ground,
    find_in_relief as find_in_relief,
    find_objects as find_objects,
    join_stacks as join_stacks,
    leave_out_standing as leave_out_standing,
    measure as measure,
    measure_thin as measure_thin,
    relief_margin as relief_margin,
    settle_solids as settle_solids,
    take_off_standing as take_off_standing,
)
