"""bumpymap: roughness layers and ride-cost maps from point clouds.

``map_survey`` maps a survey, ``map_batch`` many, ``open`` opens the layers of a run, ``find_routes`` plans ways
over them, ``ride_along`` gives the ride of a line, ``check_drives`` compares them with real drives,
``diff_surveys`` finds what has changed between two surveys, ``classify_scan`` and ``ScanClassifier`` classify the
ground in the scans of a robot; ``points_of`` reads and ``GroundGrid`` fills messages of ROS 2. Names are imported
on first use.
"""

import lazy_loader

_lazy, _, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = sorted({*_names, "__version__", "open"} - {"open_layers"})  # noqa: PLE0605 (a list)


def __getattr__(name: str) -> object:
    """Import a public name on first use; the version too, because looking it up is slow."""
    if name == "__version__":
        from importlib.metadata import version

        return version("bumpymap")
    return _lazy("open_layers" if name == "open" else name)


def __dir__() -> list[str]:
    """Return the public names."""
    return [*__all__]
