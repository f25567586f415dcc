from .reproject import (
    Place as Place,
    describe_crs as describe_crs,
    reproject_command as reproject_command,
    utm_epsg as utm_epsg,
)
from .settle import (
    CrsStatement as CrsStatement,
    common_georeference as common_georeference,
    crs_from_epsg as crs_from_epsg,
    georeference as georeference,
    horizontal_of as horizontal_of,
    linear_unit as linear_unit,
    parse_crs as parse_crs,
    same_crs as same_crs,
    scale_note as scale_note,
    statement_from_wkt as statement_from_wkt,
    unit_name as unit_name,
)
from .vertical import (
    vertical_of as vertical_of,
    with_vertical as with_vertical,
)
