from .config import (
    CLASHES as CLASHES,
    OF_CRS as OF_CRS,
    RESUME_OR_OVERWRITE as RESUME_OR_OVERWRITE,
    VEHICLE_OR_CALIBRATION as VEHICLE_OR_CALIBRATION,
    Align as Align,
    Clash as Clash,
    Compat as Compat,
    CsfSettings as CsfSettings,
    FeatureSettings as FeatureSettings,
    Ground as Ground,
    MapConfig as MapConfig,
    NameOrFile as NameOrFile,
    Rating as Rating,
    ZUnit as ZUnit,
    decide_ground as decide_ground,
    override_settings as override_settings,
    refuse_clashes as refuse_clashes,
)
from .crs import (
    CrsStatement as CrsStatement,
    GivenCrs as GivenCrs,
    Place as Place,
    common_georeference as common_georeference,
    crs_from_epsg as crs_from_epsg,
    describe_crs as describe_crs,
    georeference as georeference,
    horizontal_of as horizontal_of,
    linear_unit as linear_unit,
    parse_crs as parse_crs,
    reproject_command as reproject_command,
    same_crs as same_crs,
    scale_note as scale_note,
    stated_crs as stated_crs,
    statement_from_wkt as statement_from_wkt,
    unit_name as unit_name,
    utm_epsg as utm_epsg,
    vertical_of as vertical_of,
    with_vertical as with_vertical,
)
from .drive_types import (
    CheckedDrive as CheckedDrive,
    CheckedMap as CheckedMap,
    CheckResult as CheckResult,
    DriveLog as DriveLog,
    DrivenStretches as DrivenStretches,
    DrivenTiles as DrivenTiles,
    ImuTrack as ImuTrack,
    MapAgreement as MapAgreement,
    PlaceKind as PlaceKind,
    PlaceTrack as PlaceTrack,
    WheelTrack as WheelTrack,
)
from .errors import (
    BadInputError as BadInputError,
    BumpymapError as BumpymapError,
    OutputError as OutputError,
    TooUnknownError as TooUnknownError,
    UsageError as UsageError,
    error_chain as error_chain,
    missing_resource as missing_resource,
    refused_write as refused_write,
)
from .file_hash import (
    CHECKSUM_METHOD as CHECKSUM_METHOD,
    FileHash as FileHash,
    PieceRuns as PieceRuns,
    hash_file as hash_file,
    join_checksums as join_checksums,
)
from .files import (
    STAGED as STAGED,
    atomic as atomic,
    move_together as move_together,
    open_regular as open_regular,
    read_regular as read_regular,
    remove_empty_on_error as remove_empty_on_error,
    remove_path as remove_path,
    utf8_path as utf8_path,
    write_together as write_together,
)
from .interrupts import (
    Terminated as Terminated,
    interruptible as interruptible,
    shielded as shielded,
)
from .json_text import (
    Each as Each,
    Nullable as Nullable,
    Number as Number,
    parse_json as parse_json,
    shape_fault as shape_fault,
)
from .lock import (
    Holder as Holder,
    lock_for as lock_for,
    locked as locked,
)
from .memory import (
    LEAST_MEMORY as LEAST_MEMORY,
    auto_memory as auto_memory,
    free_memory as free_memory,
    is_auto as is_auto,
    memory_bytes as memory_bytes,
    memory_limit as memory_limit,
)
from .onnx_file import (
    check_network as check_network,
    metadata_of as metadata_of,
    onnx_runtime as onnx_runtime,
    read_network as read_network,
    session as session,
    shipped_network as shipped_network,
)
from .ply_file import (
    PLY_TYPES as PLY_TYPES,
    write_vertices as write_vertices,
)
from .processes import (
    Child as Child,
    ChildDiedError as ChildDiedError,
    ChildError as ChildError,
    allocate_shared as allocate_shared,
    can_start_children as can_start_children,
    module_folder as module_folder,
    trim_shared as trim_shared,
)
from .progress import (
    Progress as Progress,
    SilentProgress as SilentProgress,
    Steps as Steps,
    Stopwatch as Stopwatch,
    counted as counted,
)
from .remote import (
    recorded_place as recorded_place,
    remote_files as remote_files,
    without_keys as without_keys,
)
from .route_types import (
    NO_TILE as NO_TILE,
    ExportFormat as ExportFormat,
    ExportResolution as ExportResolution,
    Route as Route,
    RouteFigures as RouteFigures,
    RouteProfile as RouteProfile,
    RouteVehicle as RouteVehicle,
    TileField as TileField,
    TracedLine as TracedLine,
)
from .run_folder import (
    Kept as Kept,
    RunFolder as RunFolder,
    check_interrupted as check_interrupted,
    clean_folder as clean_folder,
    is_interrupted as is_interrupted,
    is_own_folder as is_own_folder,
    read_record as read_record,
    what_to_keep as what_to_keep,
    writing_to as writing_to,
)
from .run_spec import (
    differences as differences,
    flat_settings as flat_settings,
    recorded_settings as recorded_settings,
    same_content as same_content,
    spec_of_manifest as spec_of_manifest,
)
from .scan_types import (
    CLASSES as CLASSES,
    LONGEST_GAP_S as LONGEST_GAP_S,
    NEAREST_S as NEAREST_S,
    NOT_TRAVERSABLE as NOT_TRAVERSABLE,
    SCAN_S as SCAN_S,
    BagMessage as BagMessage,
    ClassedSectors as ClassedSectors,
    Dropped as Dropped,
    FrameSource as FrameSource,
    PolarSettings as PolarSettings,
    PoseTrack as PoseTrack,
    Scan as Scan,
    ScanMethod as ScanMethod,
    SectorBounds as SectorBounds,
    SectorRide as SectorRide,
    SectorStack as SectorStack,
    point_classes as point_classes,
    sector_bounds as sector_bounds,
)
from .settings_file import (
    UNFILLED as UNFILLED,
    field_rule as field_rule,
    parse_record as parse_record,
    parse_share as parse_share,
    path_fault as path_fault,
    path_of_call as path_of_call,
    read_settings_file as read_settings_file,
    refuse_faults as refuse_faults,
    refuse_unknown as refuse_unknown,
    settings_of_call as settings_of_call,
)
from .shared_kernels import (
    NO_PLANE as NO_PLANE,
    Plane as Plane,
    best_candidate as best_candidate,
    fill_holes as fill_holes,
    squared_distances as squared_distances,
)
from .shared_memory import (
    SharedBytes as SharedBytes,
)
from .shown_text import (
    escape_controls as escape_controls,
    write_csv as write_csv,
)
from .text import (
    count_text as count_text,
    join_lines as join_lines,
    share_text as share_text,
    shares_text as shares_text,
)
from .thin_rule import (
    DENSE_COVERAGE as DENSE_COVERAGE,
    HOLE_POINTS as HOLE_POINTS,
    HOLE_SHARE as HOLE_SHARE,
    THIN_PARTS as THIN_PARTS,
    THIN_POINTS as THIN_POINTS,
    THIN_SEEN as THIN_SEEN,
)
from .threads import (
    in_threads as in_threads,
)
from .toml_file import (
    brief_repr as brief_repr,
    read_toml as read_toml,
    short_repr as short_repr,
)
from .types import (
    BANDS as BANDS,
    BARRED_TEXT as BARRED_TEXT,
    CANOPY as CANOPY,
    CHANGE_KINDS as CHANGE_KINDS,
    CLASS_NAMES as CLASS_NAMES,
    EMPTY as EMPTY,
    FAIL_SHARE as FAIL_SHARE,
    FREE as FREE,
    LONE as LONE,
    NO_CLASS as NO_CLASS,
    OBJECT_NAMES as OBJECT_NAMES,
    OBSTACLE as OBSTACLE,
    OPEN_THROUGH as OPEN_THROUGH,
    POINT_BUILDING as POINT_BUILDING,
    POINT_GROUND as POINT_GROUND,
    POINT_OTHER as POINT_OTHER,
    POINT_PLANT as POINT_PLANT,
    REASON_TEXT as REASON_TEXT,
    SEEN as SEEN,
    SIDES as SIDES,
    SOLID as SOLID,
    SPEED_BANDS as SPEED_BANDS,
    STEEP as STEEP,
    TEXTURES as TEXTURES,
    UNDECIDED as UNDECIDED,
    UNSEEN as UNSEEN,
    Band as Band,
    Barred as Barred,
    CostMap as CostMap,
    CostRule as CostRule,
    CostTable as CostTable,
    Georeference as Georeference,
    ObjectStack as ObjectStack,
    PatchStack as PatchStack,
    PointCloud as PointCloud,
    Reason as Reason,
    Texture as Texture,
    TextureMap as TextureMap,
    VehicleBody as VehicleBody,
    neighbour_columns as neighbour_columns,
    rated_columns as rated_columns,
    speed_bands as speed_bands,
    tile_columns as tile_columns,
)
