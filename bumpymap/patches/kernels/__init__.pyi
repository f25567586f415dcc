from .measure import (
    LANES as LANES,
    SAMPLE as SAMPLE,
    SUMS as SUMS,
    fill_holes as fill_holes,
    measure_tiles as measure_tiles,
)
