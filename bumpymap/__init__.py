"""bumpymap: roughness layers and ride-cost maps from point clouds.

``map_survey`` maps surveys, ``open`` opens the layers of a run, ``classify_scan`` and ``ScanClassifier`` class the
ground of a robot's scans. A name is imported when it is used first.
"""

from importlib import import_module

TYPE_CHECKING = False  # checkers take it for True; typing itself takes longer to import than all else here
if TYPE_CHECKING:
    from bumpymap.core import BadInputError, BumpymapError, OutputError, UsageError
    from bumpymap.layers import (
        Layers,
        open_layers as open,  # noqa: A004 (as bumpymap.open)
    )
    from bumpymap.rating import Calibration, Vehicle
    from bumpymap.scan import ScanClassifier, ScanResult, classify_scan
    from bumpymap.survey import map_survey

    __version__: str

__all__ = [
    "BadInputError",
    "BumpymapError",
    "Calibration",
    "Layers",
    "OutputError",
    "ScanClassifier",
    "ScanResult",
    "UsageError",
    "Vehicle",
    "__version__",
    "classify_scan",
    "map_survey",
    "open",
]

_PLACES = {
    "BadInputError": ("bumpymap.core", "BadInputError"),
    "BumpymapError": ("bumpymap.core", "BumpymapError"),
    "Calibration": ("bumpymap.rating", "Calibration"),
    "Layers": ("bumpymap.layers", "Layers"),
    "OutputError": ("bumpymap.core", "OutputError"),
    "ScanClassifier": ("bumpymap.scan", "ScanClassifier"),
    "ScanResult": ("bumpymap.scan", "ScanResult"),
    "UsageError": ("bumpymap.core", "UsageError"),
    "Vehicle": ("bumpymap.rating", "Vehicle"),
    "classify_scan": ("bumpymap.scan", "classify_scan"),
    "map_survey": ("bumpymap.survey", "map_survey"),
    "open": ("bumpymap.layers", "open_layers"),
}
"""Name: the module that it is in, and its name there."""


if not TYPE_CHECKING:  # a checker that saw this would take any name

    def __getattr__(name: str) -> object:
        """Import a name when it is used first; the version too, which takes longer to find than many a command."""
        if name == "__version__":
            from importlib.metadata import version

            return version("bumpymap")
        if name not in _PLACES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        module, attribute = _PLACES[name]
        value = globals()[name] = getattr(import_module(module), attribute)
        return value


def __dir__() -> list[str]:
    """Name what can be used."""
    return [*__all__]
