"""bumpymap: roughness layers and ride-cost maps from point clouds.

``map_survey`` maps a survey, ``map_batch`` many, ``open`` opens the layers of a run, ``find_routes`` and ``map_reach``
plan ways over them, ``ride_along`` tells the ride of a line, ``check_drives`` compares them with real drives,
``diff_surveys`` finds what has changed between two surveys, ``classify_scan`` and ``ScanClassifier`` classify the
ground in the scans of a robot; ``points_of`` reads and ``GroundGrid`` fills messages of ROS 2. Names are imported
on first use.
"""

TYPE_CHECKING = False  # type checkers assume True; importing typing would take longer than the rest of this file
if TYPE_CHECKING:
    from bumpymap.api import Layers, map_survey, open_layers as open  # noqa: A004 (as bumpymap.open)
    from bumpymap.change import diff_surveys
    from bumpymap.check import check_drives
    from bumpymap.core import BadInputError, BumpymapError, GroundGrid, OutputError, UsageError
    from bumpymap.layers import PlannedRoute
    from bumpymap.rating import Calibration, Vehicle
    from bumpymap.readers import points_of
    from bumpymap.route import LineRide, find_routes, map_reach, ride_along
    from bumpymap.scan import ScanClassifier, ScanResult, classify_scan
    from bumpymap.survey import map_batch

    __version__: str

__all__ = [
    "BadInputError",
    "BumpymapError",
    "Calibration",
    "GroundGrid",
    "Layers",
    "LineRide",
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
    "ride_along",
]

_PLACES = {
    "api": ("Layers", "map_survey"),
    "change": ("diff_surveys",),
    "check": ("check_drives",),
    "core": ("BadInputError", "BumpymapError", "GroundGrid", "OutputError", "UsageError"),
    "layers": ("PlannedRoute",),
    "rating": ("Calibration", "Vehicle"),
    "readers": ("points_of",),
    "route": ("LineRide", "find_routes", "map_reach", "ride_along"),
    "scan": ("ScanClassifier", "ScanResult", "classify_scan"),
    "survey": ("map_batch",),
}
"""Module of this package: public names that are imported from it."""
_EXPORTS = {name: (place, name) for place, names in _PLACES.items() for name in names}
_EXPORTS["open"] = ("api", "open_layers")


if not TYPE_CHECKING:  # hidden from type checkers, which would otherwise accept any name

    def __getattr__(name: str) -> object:
        """Import a public name on first use; the version too, because looking it up is slow."""
        if name == "__version__":
            from importlib.metadata import version

            return version("bumpymap")
        if name not in _EXPORTS:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        place, attribute = _EXPORTS[name]
        value = globals()[name] = getattr(import_module(f"bumpymap.{place}"), attribute)
        return value


def __dir__() -> list[str]:
    """Return the public names."""
    return [*__all__]
