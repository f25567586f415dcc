"""bumpymap: roughness layers and ride-cost maps from point clouds.

``map_survey`` maps a survey, ``map_batch`` many, ``open`` opens the layers of a run, ``find_routes`` and ``map_reach``
plan ways over them, ``check_drives`` compares them with real drives, ``diff_surveys`` finds what has changed between
two surveys, ``classify_scan`` and ``ScanClassifier`` classify the ground in the scans of a robot; ``points_of`` and
``GroundGrid`` read and fill the messages of ROS 2. Names are imported on first use.
"""

TYPE_CHECKING = False  # type checkers assume True; importing typing would take longer than the rest of this file
if TYPE_CHECKING:
    from bumpymap.api import Layers, map_survey, open_layers as open  # noqa: A004 (as bumpymap.open)
    from bumpymap.change import diff_surveys
    from bumpymap.check import check_drives
    from bumpymap.core import BadInputError, BumpymapError, OutputError, UsageError
    from bumpymap.layers import PlannedRoute
    from bumpymap.rating import Calibration, Vehicle
    from bumpymap.readers import points_of
    from bumpymap.route import find_routes, map_reach
    from bumpymap.scan import ScanClassifier, ScanResult, classify_scan
    from bumpymap.survey import map_batch
    from bumpymap.views import GroundGrid

    __version__: str

__all__ = [
    "BadInputError",
    "BumpymapError",
    "Calibration",
    "GroundGrid",
    "Layers",
    "OutputError",
    "PlannedRoute",
    "ScanClassifier",
    "ScanResult",
    "UsageError",
    "Vehicle",
    "__version__",
    "check_drives",
    "classify_scan",
    "diff_surveys",
    "find_routes",
    "map_batch",
    "map_reach",
    "map_survey",
    "open",
    "points_of",
]

_EXPORTS = {
    "BadInputError": ("bumpymap.core", "BadInputError"),
    "BumpymapError": ("bumpymap.core", "BumpymapError"),
    "Calibration": ("bumpymap.rating", "Calibration"),
    "GroundGrid": ("bumpymap.views", "GroundGrid"),
    "Layers": ("bumpymap.api", "Layers"),
    "OutputError": ("bumpymap.core", "OutputError"),
    "PlannedRoute": ("bumpymap.layers", "PlannedRoute"),
    "ScanClassifier": ("bumpymap.scan", "ScanClassifier"),
    "ScanResult": ("bumpymap.scan", "ScanResult"),
    "UsageError": ("bumpymap.core", "UsageError"),
    "Vehicle": ("bumpymap.rating", "Vehicle"),
    "check_drives": ("bumpymap.check", "check_drives"),
    "classify_scan": ("bumpymap.scan", "classify_scan"),
    "diff_surveys": ("bumpymap.change", "diff_surveys"),
    "find_routes": ("bumpymap.route", "find_routes"),
    "map_batch": ("bumpymap.survey", "map_batch"),
    "map_reach": ("bumpymap.route", "map_reach"),
    "map_survey": ("bumpymap.api", "map_survey"),
    "open": ("bumpymap.api", "open_layers"),
    "points_of": ("bumpymap.readers", "points_of"),
}
"""Public name: the module to import and the name in it."""


if not TYPE_CHECKING:  # hidden from type checkers, which would otherwise accept any name

    def __getattr__(name: str) -> object:
        """Import a public name on first use; the version too, because looking it up is slow."""
        if name == "__version__":
            from importlib.metadata import version

            return version("bumpymap")
        if name not in _EXPORTS:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        module, attribute = _EXPORTS[name]
        value = globals()[name] = getattr(import_module(module), attribute)
        return value


def __dir__() -> list[str]:
    """Return the public names."""
    return [*__all__]
