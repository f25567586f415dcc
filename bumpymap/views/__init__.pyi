from .export.gridmap import (
    check_bag_file as check_bag_file,
    write_grid_bag as write_grid_bag,
)
from .export.write import (
    Export as Export,
    export_map as export_map,
)
from .gis.project import (
    change_layers as change_layers,
    check_layers as check_layers,
    route_layers as route_layers,
    view_writers as view_writers,
    write_map_views as write_map_views,
)
from .page.batch_page import (
    SurveyView as SurveyView,
    index_page as index_page,
    read_thumbnail as read_thumbnail,
)
from .page.change_page import (
    write_change_report as write_change_report,
)
from .page.map_page import (
    write_check_page as write_check_page,
    write_report as write_report,
)
from .page.site import (
    page_header as page_header,
)
from .scan_picture import (
    write_picture as write_picture,
)
from .space import (
    show_in_space as show_in_space,
)
from .words import (
    agreements_of as agreements_of,
    area as area,
    check_headline as check_headline,
    columns_words as columns_words,
    degrees_line as degrees_line,
    least_volume_text as least_volume_text,
    volumes_text as volumes_text,
    warnings_of as warnings_of,
    zones_line as zones_line,
)
