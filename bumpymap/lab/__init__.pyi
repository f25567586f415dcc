from .evaluate.document import (
    REPORT as REPORT,
    number as number,
    percent as percent,
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
from .evaluate.routes.planner import (
    RoutePlanner as RoutePlanner,
)
from .evaluate.routes.report import (
    write_route_report as write_route_report,
)
from .evaluate.routes.run import (
    RouteFindings as RouteFindings,
    evaluate_routes as evaluate_routes,
    require_calibration as require_calibration,
)
from .evaluate.routes.settings import (
    RouteTrialSettings as RouteTrialSettings,
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
    ScanMethods as ScanMethods,
    compare_sensors as compare_sensors,
    evaluate_scans as evaluate_scans,
    labels_of as labels_of,
    read_frames as read_frames,
    simulated_scans as simulated_scans,
)
from .evaluate.scan.settings import (
    ScanEvaluateSettings as ScanEvaluateSettings,
)
from .evaluate.scan.timing import (
    require_libraries as require_libraries,
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
from .evaluate.trial import (
    TrialOptions as TrialOptions,
)
from .simulate.calibrate import (
    calibrate_vehicle as calibrate_vehicle,
    seconds_of_a_drive as seconds_of_a_drive,
)
from .simulate.checks import (
    all_checks as all_checks,
)
from .simulate.drive import (
    DriveSettings as DriveSettings,
)
from .simulate.drive_log import (
    RecordedWay as RecordedWay,
    RecordSettings as RecordSettings,
    record_way as record_way,
)
from .simulate.journal import (
    Journal as Journal,
)
from .simulate.library import (
    library_terrains as library_terrains,
)
from .simulate.model import (
    Physics as Physics,
    require_dart as require_dart,
)
from .simulate.motion import (
    MotionEffort as MotionEffort,
    motion_journal as motion_journal,
)
from .simulate.motion_fit import (
    add_motion as add_motion,
)
from .simulate.plan import (
    CalibrationSettings as CalibrationSettings,
)
from .simulate.ride_fit import (
    fit_ride as fit_ride,
)
from .simulate.steps import (
    add_steps as add_steps,
    crossing_jobs as crossing_jobs,
)
from .simulate.terrain import (
    PatchGround as PatchGround,
)
from .simulate.thin_surveys import (
    fit_thin_surveys as fit_thin_surveys,
)
from .train.evaluate import (
    predict as predict,
)
from .train.make import (
    make_model as make_model,
)
from .train.model import (
    NetworkSettings as NetworkSettings,
)
from .train.output import (
    TrainedModel as TrainedModel,
)
from .train.scan.make import (
    make_scan_model as make_scan_model,
)
from .train.scan.train import (
    ScanTrainSettings as ScanTrainSettings,
)
from .train.score import (
    count_answers as count_answers,
)
from .train.train import (
    TrainSettings as TrainSettings,
)
from .train.training import (
    EpochReport as EpochReport,
)
from .worlds.drives.files import (
    write_drive_files as write_drive_files,
)
from .worlds.drives.grades import (
    GNSS as GNSS,
    IMUS as IMUS,
    ClockFault as ClockFault,
    DriveSensors as DriveSensors,
    Vibration as Vibration,
)
from .worlds.drives.log import (
    SensedDrive as SensedDrive,
    sense_drive as sense_drive,
)
from .worlds.drives.motion import (
    TrueDrive as TrueDrive,
    read_motion as read_motion,
    save_motion as save_motion,
)
from .worlds.sample._surfaces import (
    CROWN as CROWN,
    KERB_HEIGHT as KERB_HEIGHT,
    RAMP_SLOPE_DEG as RAMP_SLOPE_DEG,
    WASHBOARD_AMPLITUDE as WASHBOARD_AMPLITUDE,
    WASHBOARD_LENGTH as WASHBOARD_LENGTH,
)
from .worlds.sample.files import (
    make_quarry_survey as make_quarry_survey,
)
from .worlds.sample.site import (
    ZONES as ZONES,
    QuarrySite as QuarrySite,
)
from .worlds.sample.survey import (
    NOISE_SIGMA as NOISE_SIGMA,
    sample_survey as sample_survey,
)
from .worlds.scans.folder import (
    write_folder as write_folder,
)
from .worlds.scans.labels import (
    Label as Label,
)
from .worlds.scans.lidar import (
    load_open3d as load_open3d,
    simulate_scan as simulate_scan,
)
from .worlds.scans.scene import (
    make_scene as make_scene,
)
from .worlds.scans.sensor import (
    SENSORS as SENSORS,
    Sensor as Sensor,
)
from .worlds.terrains.library import (
    FINE as FINE,
    KINDS as KINDS,
    Terrain as Terrain,
    make_terrain as make_terrain,
)
from .worlds.terrains.survey import (
    ScanEffects as ScanEffects,
    survey_terrain as survey_terrain,
)
