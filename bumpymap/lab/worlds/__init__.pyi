from .drives.motion import (
    TrueDrive as TrueDrive,
)
from .scans.lidar import (
    simulate_scan as simulate_scan,
)
from .scans.overhead import (
    overhead_scan as overhead_scan,
)
from .scans.scene import (
    make_scene as make_scene,
)
from .scans.sensor import (
    SENSORS as SENSORS,
    draw_sensor as draw_sensor,
)
from .terrains.library import (
    FINE as FINE,
    KINDS as KINDS,
    Terrain as Terrain,
    make_terrain as make_terrain,
)
from .terrains.survey import (
    ScanEffects as ScanEffects,
    survey_terrain as survey_terrain,
)
