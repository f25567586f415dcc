from .files import (
    write_drive_files as write_drive_files,
)
from .grades import (
    GNSS as GNSS,
    IMUS as IMUS,
    ClockFault as ClockFault,
    DriveSensors as DriveSensors,
    GnssGrade as GnssGrade,
    ImuGrade as ImuGrade,
    SensorGrade as SensorGrade,
    Vibration as Vibration,
)
from .log import (
    SensedDrive as SensedDrive,
    SensorTruth as SensorTruth,
    sense_drive as sense_drive,
)
from .motion import (
    GRAVITY as GRAVITY,
    TrueDrive as TrueDrive,
    read_motion as read_motion,
    save_motion as save_motion,
)
