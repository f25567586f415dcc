from ._fields import (
    make_field as make_field,
)
from ._solids import (
    boxes as boxes,
    leaves as leaves,
    ribbon as ribbon,
    stones as stones,
    tube as tube,
)
