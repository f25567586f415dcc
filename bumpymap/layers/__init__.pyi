from ._imports import (
    import_without_pandas as import_without_pandas,
)
from .batch_page import (
    SurveyRow as SurveyRow,
    SurveyStatus as SurveyStatus,
    SurveyView as SurveyView,
    index_page as index_page,
    read_thumbnail as read_thumbnail,
)
from .batch_summary import (
    BATCH_LOG as BATCH_LOG,
    BATCH_NAMES as BATCH_NAMES,
    check_batch_out as check_batch_out,
    map_facts as map_facts,
    write_batch_summary as write_batch_summary,
)
from .change import (
    CHANGE_MANIFEST_NAME as CHANGE_MANIFEST_NAME,
    CHANGE_NAMES as CHANGE_NAMES,
    CHANGE_VIEW_NAMES as CHANGE_VIEW_NAMES,
    ChangeField as ChangeField,
    SurveyPair as SurveyPair,
    SurveyTiles as SurveyTiles,
    change_regions as change_regions,
    check_change_out as check_change_out,
    open_pair as open_pair,
    write_change as write_change,
)
from .check.record import (
    CHECK_MANIFEST_NAME as CHECK_MANIFEST_NAME,
    CHECK_NAMES as CHECK_NAMES,
    CHECK_VIEW_NAMES as CHECK_VIEW_NAMES,
    check_check_out as check_check_out,
    read_check as read_check,
)
from .check.vectors import CheckGround as CheckGround
from .check.words import (
    check_headline as check_headline,
    check_verdict as check_verdict,
    columns_words as columns_words,
    level_words as level_words,
    warnings_of as warnings_of,
)
from .check_files import write_check as write_check
from .colours import (
    BARRED_COLOURS as BARRED_COLOURS,
    CHANGE_COLOURS as CHANGE_COLOURS,
    CLASS_COLOURS as CLASS_COLOURS,
    OBJECT_COLOURS as OBJECT_COLOURS,
    OFF_COLOURS as OFF_COLOURS,
    REASON_COLOURS as REASON_COLOURS,
)
from .export.write import (
    Export as Export,
    ExportSettings as ExportSettings,
    export_map as export_map,
)
from .folder import (
    is_complete as is_complete,
    refuse_replacing as refuse_replacing,
    verified_record as verified_record,
    write_products as write_products,
    write_tiles as write_tiles,
)
from .geotiff import (
    write_barred as write_barred,
    write_classes as write_classes,
    write_cost as write_cost,
    write_heightmap as write_heightmap,
    write_obstacles as write_obstacles,
    write_passage as write_passage,
    write_reasons as write_reasons,
    write_relief as write_relief,
    write_roughness as write_roughness,
)
from .gis.project import (
    write_project as write_project,
)
from .gis.styles import (
    write_styles as write_styles,
)
from .manifest import (
    MANIFEST_NAME as MANIFEST_NAME,
    complete_manifest as complete_manifest,
    describe_file as describe_file,
    describe_input as describe_input,
    software_versions as software_versions,
    write_manifest as write_manifest,
)
from .map_files import RemoteFolder as RemoteFolder
from .opened import (
    Layers as Layers,
    folder_of as folder_of,
    open_layers as open_layers,
    temporary_folder as temporary_folder,
)
from .placement import (
    MAX_PIXELS as MAX_PIXELS,
    MAX_TILES as MAX_TILES,
    Placement as Placement,
    check_extent as check_extent,
    fits_one_map as fits_one_map,
)
from .products import (
    EVERY_VIEW_NAME as EVERY_VIEW_NAME,
    PRODUCT_NAMES as PRODUCT_NAMES,
    REPORT_NAME as REPORT_NAME,
    SHEET_FOLDER as SHEET_FOLDER,
    VIEW_NAMES as VIEW_NAMES,
    check_folder as check_folder,
)
from .regions import (
    dissolve as dissolve,
    label as label,
)
from .report.map_page import (
    write_report as write_report,
    write_reports as write_reports,
)
from .report.page import compile_pages as compile_pages
from .report.words import degrees_line as degrees_line
from .route.folder import (
    ReachLevels as ReachLevels,
    write_reach_files as write_reach_files,
    write_routes as write_routes,
)
from .route.lines import (
    PROFILE_COLUMNS as PROFILE_COLUMNS,
    MapSource as MapSource,
    route_properties as route_properties,
    write_gpx as write_gpx,
    write_profile as write_profile,
    write_route_geojson as write_route_geojson,
)
from .route.picture import (
    ROUTE_MANIFEST_NAME as ROUTE_MANIFEST_NAME,
    ROUTE_NAMES as ROUTE_NAMES,
    check_reach_out as check_reach_out,
    check_route_out as check_route_out,
    paint_route as paint_route,
    write_route_picture as write_route_picture,
)
from .route.planned import (
    PlannedRoute as PlannedRoute,
    reach_dataset as reach_dataset,
)
from .route.reach import (
    NO_MOVE as NO_MOVE,
    ReachField as ReachField,
    write_isochrones as write_isochrones,
    write_reach as write_reach,
    write_reach_back as write_reach_back,
)
from .route_inputs import (
    FilePoint as FilePoint,
    read_areas as read_areas,
    read_points as read_points,
    tiles_in as tiles_in,
    tiles_within as tiles_within,
)
from .route_map import (
    RouteMap as RouteMap,
    open_map as open_map,
)
from .scan.folder import (
    ACCUMULATED_NAME as ACCUMULATED_NAME,
    FRAME_FOLDER as FRAME_FOLDER,
    MAP_FOLDER as MAP_FOLDER,
    SCAN_CLASS_NAMES as SCAN_CLASS_NAMES,
    SCAN_COLOURS as SCAN_COLOURS,
    SCAN_MANIFEST_NAME as SCAN_MANIFEST_NAME,
    SECTOR_TABLE_NAME as SECTOR_TABLE_NAME,
    Frame as Frame,
    FramePart as FramePart,
    FrameReport as FrameReport,
    check_scan_folder as check_scan_folder,
    explain_empty_scan as explain_empty_scan,
    file_sizes as file_sizes,
    has_finished_parts as has_finished_parts,
    load_part as load_part,
    name_frames as name_frames,
    output_errors as output_errors,
    part_path as part_path,
    remove_stale_products as remove_stale_products,
    report_frame as report_frame,
    sample_evenly as sample_evenly,
    save_part as save_part,
    sync_to_disk as sync_to_disk,
    write_scan_manifest as write_scan_manifest,
)
from .scan.frame import (
    frame_files as frame_files,
    has_files as has_files,
    write_frame as write_frame,
)
from .scan.grid_bag import (
    GridBag as GridBag,
    GridSettings as GridSettings,
    GroundGrid as GroundGrid,
    check_bag_file as check_bag_file,
)
from .scan.table import (
    AccumulatedSurvey as AccumulatedSurvey,
    SectorTable as SectorTable,
    open_accumulated as open_accumulated,
    open_table as open_table,
    sector_rows as sector_rows,
)
from .sheets.folders import (
    in_sheets as in_sheets,
    remove_sheets as remove_sheets,
    sheet_folders as sheet_folders,
)
from .sheets.write import (
    SheetLayout as SheetLayout,
    SheetRun as SheetRun,
    made_names as made_names,
    require_whole as require_whole,
    suggested_sheets as suggested_sheets,
    write_sheets as write_sheets,
)
from .stac.item import (
    write_catalog as write_catalog,
    write_item as write_item,
)
from .summary import (
    MapSummary as MapSummary,
    summarise as summarise,
)
from .vector import (
    GeoJsonCoordinates as GeoJsonCoordinates,
    flatgeobuf_writer as flatgeobuf_writer,
    geojson_writer as geojson_writer,
)
