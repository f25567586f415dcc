from ._cog import (
    write_cog as write_cog,
)
from ._imports import (
    import_notebook as import_notebook,
    import_without_pandas as import_without_pandas,
)
from .batch import (
    BATCH_LINKS as BATCH_LINKS,
    BATCH_NAMES as BATCH_NAMES,
    SurveyRow as SurveyRow,
    SurveyStatus as SurveyStatus,
    check_batch_out as check_batch_out,
    map_facts as map_facts,
    write_batch_summary as write_batch_summary,
)
from .change import (
    CHANGED_BAND as CHANGED_BAND,
    ChangeField as ChangeField,
    SurveyPair as SurveyPair,
    SurveyTiles as SurveyTiles,
    open_pair as open_pair,
    write_change_raster as write_change_raster,
    write_change_regions as write_change_regions,
)
from .check_files import (
    MapOffset as MapOffset,
    check_entries as check_entries,
    place_stretches as place_stretches,
    write_stretches as write_stretches,
)
from .colours import (
    BARRED_COLOURS as BARRED_COLOURS,
    CHANGE_COLOURS as CHANGE_COLOURS,
    CLASS_COLOURS as CLASS_COLOURS,
    CLOSED_COLOUR as CLOSED_COLOUR,
    COST_COLOURS as COST_COLOURS,
    DIFFERENCE_RAMP as DIFFERENCE_RAMP,
    ISLAND_SHARE as ISLAND_SHARE,
    MID_GREY as MID_GREY,
    OBJECT_COLOURS as OBJECT_COLOURS,
    OFF_COLOURS as OFF_COLOURS,
    OFF_KINDS as OFF_KINDS,
    PASSAGE_COLOURS as PASSAGE_COLOURS,
    PASSAGE_NAMES as PASSAGE_NAMES,
    REASON_SHADES as REASON_SHADES,
    ROUTE_COLOUR as ROUTE_COLOUR,
    STEP_LINE as STEP_LINE,
    UNKNOWN_COLOUR as UNKNOWN_COLOUR,
    UNKNOWN_OBJECT as UNKNOWN_OBJECT,
    RideScale as RideScale,
    class_limits as class_limits,
    class_ranges as class_ranges,
    on_islands as on_islands,
)
from .folder import (
    box_sum as box_sum,
    write_products as write_products,
)
from .lazy_raster import (
    lazy_values as lazy_values,
)
from .manifest import (
    COUNT as COUNT,
    ISLAND_M2 as ISLAND_M2,
    MANIFEST_NAME as MANIFEST_NAME,
    MapSummary as MapSummary,
    ZoneCounts as ZoneCounts,
    describe_file as describe_file,
    describe_input as describe_input,
    first_island as first_island,
    place_entries as place_entries,
    read_manifest as read_manifest,
    software_versions as software_versions,
    write_manifest as write_manifest,
)
from .map_reader import (
    MapReader as MapReader,
    common_window as common_window,
    open_layer as open_layer,
    open_map as open_map,
    read_averaged as read_averaged,
    read_colours as read_colours,
    require_written as require_written,
)
from .orthophoto import (
    open_photo as open_photo,
)
from .placement import (
    Placement as Placement,
    RasterSpec as RasterSpec,
    RasterWindow as RasterWindow,
    check_extent as check_extent,
)
from .products import (
    CHECK_FILES as CHECK_FILES,
    EVERY_VIEW_NAME as EVERY_VIEW_NAME,
    OTHER_FILES as OTHER_FILES,
    PRODUCT_NAMES as PRODUCT_NAMES,
    REPORT_NAME as REPORT_NAME,
    MapFile as MapFile,
    OutputFolder as OutputFolder,
    check_folder as check_folder,
    is_complete as is_complete,
    refuse_present as refuse_present,
    refuse_replacing as refuse_replacing,
    require_folder as require_folder,
    require_new_file as require_new_file,
    verified_record as verified_record,
)
from .route_files import (
    route_coordinates as route_coordinates,
    route_properties as route_properties,
    stop_names as stop_names,
    stop_roles as stop_roles,
    window_around as window_around,
    write_gpx as write_gpx,
    write_profile as write_profile,
    write_route_geojson as write_route_geojson,
)
from .route_inputs import (
    geojson_features as geojson_features,
    line_parts as line_parts,
    read_areas as read_areas,
    read_points as read_points,
    tiles_in as tiles_in,
)
from .scan_folder import (
    ACCUMULATED_NAME as ACCUMULATED_NAME,
    FRAME_FOLDER as FRAME_FOLDER,
    MAP_FOLDER as MAP_FOLDER,
    OBSTACLE_POINT as OBSTACLE_POINT,
    OTHER_POINT as OTHER_POINT,
    SCAN_CLASS_NAMES as SCAN_CLASS_NAMES,
    SCAN_COLOURS as SCAN_COLOURS,
    SCAN_MANIFEST_NAME as SCAN_MANIFEST_NAME,
    SECTOR_TABLE_NAME as SECTOR_TABLE_NAME,
    FramePart as FramePart,
    check_scan_folder as check_scan_folder,
    class_index as class_index,
    explain_empty_scan as explain_empty_scan,
    frame_files as frame_files,
    has_finished_parts as has_finished_parts,
    load_part as load_part,
    move_products as move_products,
    name_frames as name_frames,
    open_accumulated as open_accumulated,
    open_table as open_table,
    output_errors as output_errors,
    part_path as part_path,
    point_styles as point_styles,
    present_products as present_products,
    report_frame as report_frame,
    save_part as save_part,
    sector_rows as sector_rows,
    write_cloud as write_cloud,
    write_scan_manifest as write_scan_manifest,
)
from .tile_table import (
    read_tiles as read_tiles,
    require_tiles as require_tiles,
    tile_fields as tile_fields,
)
from .vector import (
    GeoJsonCoordinates as GeoJsonCoordinates,
    label as label,
    outline_of as outline_of,
)
