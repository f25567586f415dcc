from .decoder import (
    close_decoder as close_decoder,
    start_decoder as start_decoder,
)
from .detect import (
    find_surveys as find_surveys,
    identity as identity,
    open_survey as open_survey,
    project_photo as project_photo,
    project_survey as project_survey,
    rasters_beside as rasters_beside,
    reopen_survey as reopen_survey,
)
from .drive_signals import parse_columns as parse_columns
from .drives import (
    close_log_reader as close_log_reader,
    drive_files as drive_files,
    read_drive as read_drive,
)
from .point_stats import (
    CELL as CELL,
    QUANTA as QUANTA,
    LineSums as LineSums,
    PointStats as PointStats,
    cell_indices as cell_indices,
)
from .poses import (
    FramePoses as FramePoses,
    files_beside_poses as files_beside_poses,
    place_sources as place_sources,
    read_poses as read_poses,
)
from .protocol import (
    Chunk as Chunk,
    ReadOptions as ReadOptions,
    SurveyInfo as SurveyInfo,
    SurveyReader as SurveyReader,
)
from .raw_scans import (
    BagReader as BagReader,
    bag_files as bag_files,
    points_of as points_of,
)
from .scans import (
    BagTopics as BagTopics,
    bags_at as bags_at,
    deskew as deskew,
    find_frames as find_frames,
    find_sources as find_sources,
    label_file as label_file,
    read_message as read_message,
    read_scan as read_scan,
    scene_points as scene_points,
)
from .source import (
    Location as Location,
    NoPointsError as NoPointsError,
    Version as Version,
    file_changed as file_changed,
    hash_survey as hash_survey,
)
from .summary import (
    PointSummary as PointSummary,
    PointSummaryBuilder as PointSummaryBuilder,
)
from .unclassified import (
    BLANK as BLANK,
    GROUND as GROUND,
    REACH as REACH,
    Lowest as Lowest,
    UnclassifiedPart as UnclassifiedPart,
    tile_marks as tile_marks,
)
