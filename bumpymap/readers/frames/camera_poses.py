"""Poses of KITTI's camera become those of the LiDAR; poses in other wrong frames are refused.

A vehicle moves within the x-y plane of its LiDAR, whose z axis points up, and along the z axis of its camera. The share
of the way that goes along the z axis of the poses therefore tells both apart.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.source import open_source

__all__ = ["CALIB_NAME", "calib_beside", "in_lidar_frame", "refuse_wrong_frame"]

CALIB_NAME = "calib.txt"
_STEP_M = 0.5
"""Way after which the direction of motion is measured."""
_LEAST_WAY_M = 3.0
"""Shorter drives do not tell their frame."""
_MOST_ALONG_Z, _CAMERA_ALONG_Z = 0.3, 0.7
"""Share of the way along z: at most this for a LiDAR, at least this for a camera."""
_LEAST_UP = 0.3
"""Least mean of the z axes' upward component: the mean tilt of a sensor is below 72 degrees."""
_ROUNDING = 0.02


def calib_beside(folders: Sequence[Path]) -> Path | None:
    """Return KITTI's ``calib.txt`` in the first of some folders that has it; None if none has."""
    return next((folder / CALIB_NAME for folder in folders if (folder / CALIB_NAME).is_file()), None)


def in_lidar_frame(poses: NDArray[np.float64], calib: Path, *, is_kitti: bool) -> NDArray[np.float64] | None:
    """Turn poses of the left camera into those of the LiDAR.

    Parameters
    ----------
    poses : (n, 4, 4)
    calib : Path
        A file with the line ``Tr:``, the transform from the LiDAR to the camera.
    is_kitti : bool
        Whether the poses are in KITTI's format, whose poses are of the camera unless their motion shows otherwise.

    Returns
    -------
    (n, 4, 4) or None
        In the frame of the first LiDAR pose. None if the poses move like those of a LiDAR, or ``calib`` has no ``Tr:``.

    Raises
    ------
    BadInputError
        ``Tr:`` is not a transform.
    """
    along_z = _share_along_z(poses)
    is_camera = is_kitti if along_z is None else along_z > (_MOST_ALONG_Z if is_kitti else _CAMERA_ALONG_Z)
    transform = _read_transform(calib) if is_camera else None
    if transform is None:
        return None
    turned: NDArray[np.float64] = np.linalg.inv(transform) @ poses @ transform
    return turned


def refuse_wrong_frame(path: Path, poses: NDArray[np.float64]) -> None:
    """Raise BadInputError if the poses are those of a camera, or their z axes do not point up."""
    along_z = _share_along_z(poses)
    if along_z is not None and along_z > _CAMERA_ALONG_Z:
        raise BadInputError(
            f"{path} holds the poses of a camera: {along_z:.0%} of the way goes along their z axis, but the z axis of "
            f"a LiDAR points up. KITTI: put the sequence's {CALIB_NAME} (with the line Tr:) beside it. Otherwise "
            "convert the poses to those of the LiDAR: pose of the camera times the transform from LiDAR to camera"
        )
    upward = float(poses[:, 2, 2].mean())
    if upward < _LEAST_UP:
        raise BadInputError(
            f"{path}: the z axis of the LiDAR does not point up in the world of the poses (mean upward component "
            f"{upward:.2f}; 1 is upright). Is the world that of a camera (y down) or NED (z down), are the transforms "
            "inverted, or do quaternions begin with w instead of x? Convert the poses: x forward, y left, z up, from "
            "the LiDAR to the world"
        )


def _share_along_z(poses: NDArray[np.float64]) -> float | None:
    """Return the share of the way along the z axis of the poses, 0..1; None if the way is too short to tell."""
    places = poses[:, :3, 3]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    steps = np.floor(way / _STEP_M)
    marks = np.unique([0, *np.flatnonzero(np.diff(steps) > 0.0) + 1, len(way) - 1])
    moved = np.diff(places[marks], axis=0)
    lengths = np.linalg.norm(moved, axis=1)
    if lengths.sum() < _LEAST_WAY_M:
        return None
    ahead = np.einsum("nij,ni->nj", poses[marks[:-1], :3, :3], moved)
    return float(np.abs(ahead[:, 2]).sum() / lengths.sum())


def _read_transform(calib: Path) -> NDArray[np.float64] | None:
    with open_source(calib) as stream:
        lines = stream.read(1 << 16).decode("utf-8", "replace").splitlines()
    line = next((line for line in lines if line.strip().lower().startswith("tr:")), None)
    if line is None:
        return None
    transform = np.eye(4)
    try:
        transform[:3] = np.array([float(word) for word in line.split(":", 1)[1].split()]).reshape(3, 4)
    except ValueError:
        transform[:] = np.nan
    turn = transform[:3, :3]
    if not np.isfinite(transform).all() or np.abs(turn @ turn.T - np.eye(3)).max() > _ROUNDING:
        raise BadInputError(f"the line Tr: of {calib} is not a transform: it must be twelve numbers, a 3 x 4 matrix")
    return transform
