from .evaluate.agreement import (
    confusion as confusion,
)
from .evaluate.document import (
    REPORT as REPORT,
    number as number,
    percent as percent,
    report_text as report_text,
    section as section,
    table as table,
    write_document as write_document,
)
from .evaluate.findings import (
    Findings as Findings,
)
from .evaluate.pictures import (
    require_matplotlib as require_matplotlib,
)
from .evaluate.report import (
    write_report as write_report,
)
from .evaluate.run import (
    evaluate_library as evaluate_library,
    evaluate_survey as evaluate_survey,
)
from .evaluate.scan.report import (
    write_scan_report as write_scan_report,
)
from .evaluate.scan.run import (
    ScanFindings as ScanFindings,
    evaluate_scans as evaluate_scans,
    made_up as made_up,
    read_frames as read_frames,
)
from .evaluate.scan.settings import (
    ScanEvaluateSettings as ScanEvaluateSettings,
)
from .evaluate.scan.timing import (
    require_plain as require_plain,
)
from .evaluate.settings import (
    EvaluateSettings as EvaluateSettings,
)
from .evaluate.subject import (
    Subject as Subject,
)
from .evaluate.survey import (
    open_readers as open_readers,
)
from .evaluate.tables import (
    confusion_lines as confusion_lines,
)
from .evaluate.timing import (
    peak_bytes as peak_bytes,
)
from .evaluate.trial import (
    TrialOptions as TrialOptions,
)
from .simulate.calibrate import (
    calibrate_vehicle as calibrate_vehicle,
)
from .simulate.checks import (
    all_checks as all_checks,
)
from .simulate.drive import (
    DriveSettings as DriveSettings,
)
from .simulate.journal import (
    Journal as Journal,
    Key as Key,
)
from .simulate.library import (
    library_terrains as library_terrains,
)
from .simulate.model import (
    Physics as Physics,
    require_dart as require_dart,
)
from .simulate.patch import (
    Effort as Effort,
    PatchDrives as PatchDrives,
)
from .simulate.plan import (
    CalibrationSettings as CalibrationSettings,
    library_terrain as library_terrain,
)
from .simulate.ride_fit import (
    fit_ride as fit_ride,
    relief_of as relief_of,
    surveyed as surveyed,
)
from .simulate.terrain import (
    PatchGround as PatchGround,
)
from .simulate.validate import (
    drive_patches as drive_patches,
)
from .train.evaluate import (
    Evaluation as Evaluation,
    predict as predict,
)
from .train.make import (
    make_model as make_model,
)
from .train.model import (
    NetworkSettings as NetworkSettings,
)
from .train.onnx_graph import (
    OnnxGraph as OnnxGraph,
)
from .train.output import (
    MadeModel as MadeModel,
    model_files as model_files,
    model_metadata as model_metadata,
)
from .train.scan.data import (
    UNSEEN as UNSEEN,
    scene_scan as scene_scan,
)
from .train.scan.evaluate import (
    ScanEvaluation as ScanEvaluation,
)
from .train.scan.make import (
    make_scan_model as make_scan_model,
)
from .train.scan.train import (
    ScanTrainSettings as ScanTrainSettings,
)
from .train.score import (
    Score as Score,
    count_answers as count_answers,
    score_table as score_table,
)
from .train.train import (
    TrainSettings as TrainSettings,
)
from .train.training import (
    EpochData as EpochData,
    EpochReport as EpochReport,
    LoopSettings as LoopSettings,
    Training as Training,
)
from .worlds.sample._surfaces import (
    CROWN as CROWN,
    KERB_HEIGHT as KERB_HEIGHT,
    RAMP_SLOPE_DEG as RAMP_SLOPE_DEG,
    WASHBOARD_AMPLITUDE as WASHBOARD_AMPLITUDE,
    WASHBOARD_LENGTH as WASHBOARD_LENGTH,
)
from .worlds.sample.files import (
    SampleFiles as SampleFiles,
    make_quarry_survey as make_quarry_survey,
)
from .worlds.sample.site import (
    EPSG as EPSG,
    ZONES as ZONES,
    QuarrySite as QuarrySite,
    Zone as Zone,
)
from .worlds.sample.survey import (
    NOISE_SIGMA as NOISE_SIGMA,
    SurveyPoints as SurveyPoints,
    sample_survey as sample_survey,
)
from .worlds.scans.folder import (
    write_folder as write_folder,
)
from .worlds.scans.labels import (
    Label as Label,
)
from .worlds.scans.lidar import (
    SimulatedScan as SimulatedScan,
    load_open3d as load_open3d,
    simulate_scan as simulate_scan,
)
from .worlds.scans.overhead import (
    look_down as look_down,
)
from .worlds.scans.scene import (
    THEMES as THEMES,
    Scene as Scene,
    make_scene as make_scene,
)
from .worlds.scans.sensor import (
    SENSORS as SENSORS,
    Sensor as Sensor,
    draw_sensor as draw_sensor,
)
from .worlds.terrains.library import (
    FINE as FINE,
    KINDS as KINDS,
    Terrain as Terrain,
    make_terrain as make_terrain,
)
from .worlds.terrains.survey import (
    ScanEffects as ScanEffects,
    TerrainPoints as TerrainPoints,
    survey_terrain as survey_terrain,
)
