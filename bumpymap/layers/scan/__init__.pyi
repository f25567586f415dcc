from .folder import (
    GATHERED as GATHERED,
    MANIFEST as MANIFEST,
    MAP_FOLDER as MAP_FOLDER,
    TABLE as TABLE,
    check_scan_folder as check_scan_folder,
    drop_older as drop_older,
    sync as sync,
    writing as writing,
)
from .frame import (
    has_files as has_files,
    write_frame as write_frame,
)
from .gather import (
    Gathered as Gathered,
    ground_points as ground_points,
    open_gathered as open_gathered,
)
from .manifest import (
    write_scan_manifest as write_scan_manifest,
)
from .names import (
    FRAME_FILES as FRAME_FILES,
    FRAME_FOLDER as FRAME_FOLDER,
    Frame as Frame,
    name_frames as name_frames,
    spread_out as spread_out,
)
from .part import (
    FramePart as FramePart,
    finished_parts as finished_parts,
    load_part as load_part,
    part_path as part_path,
    save_part as save_part,
)
from .report import (
    FrameReport as FrameReport,
    report_frame as report_frame,
    why_empty as why_empty,
)
from .style import (
    COLOURS as COLOURS,
    NAMES as NAMES,
)
from .table import (
    SectorTable as SectorTable,
    open_table as open_table,
    sector_rows as sector_rows,
)
