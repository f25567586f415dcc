from .folder import (
    write_folder as write_folder,
)
from .labels import (
    Label as Label,
)
from .lidar import (
    SimulatedScan as SimulatedScan,
    load_open3d as load_open3d,
    simulate_scan as simulate_scan,
)
from .overhead import (
    look_down as look_down,
)
from .scene import (
    THEMES as THEMES,
    Scene as Scene,
    make_scene as make_scene,
)
from .sensor import (
    SENSORS as SENSORS,
    Sensor as Sensor,
    draw_sensor as draw_sensor,
)
