"""Whether scans can be made up here."""

from bumpymap.errors import UsageError

__all__ = ["require_simulator"]


def require_simulator(what: str) -> None:
    """Load the library that casts rays: where it is installed, a library of the system may still be missing.

    Parameters
    ----------
    what : str
        What needs it, for the message.
    """
    try:
        import open3d  # noqa: F401
    except (ImportError, OSError) as error:
        raise UsageError(
            f"{what} needs open3d, which cannot be loaded: {error}. Install it with: pip install 'bumpymap[o3d]'; it "
            "needs the system libraries libusb-1.0-0, libegl1, libgl1 and libx11-6 too"
        ) from error
