"""Compiled loop: the motion of a vehicle on patches; see ``bumpymap.rating.ride.motion_operator`` for the model."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.ride._ride_kernels import (
    PatchesToRide,
    RideScratch,
    lay_nodes,
    roll_wheel,
    sample_means,
    take_group,
)
from bumpymap.rating.ride.operator import PitchSamples, WheelShape
from bumpytiles import kernel

__all__ = ["move_over_patches"]

Floats = NDArray[np.float64]


@kernel
def move_over_patches(
    patches: PatchesToRide,
    wheel: WheelShape,
    samples: PitchSamples,
    bounds: Annotated[NDArray[np.int64], 1],
    motions: Annotated[Floats, 3],
    scratch: RideScratch,
) -> None:
    """Roll a vehicle over patches.

    ``motions`` (tiles, groups, 2) is filled: mean absolute value and root mean square of the samples of each group, the
    rows from one of ``bounds`` to the next.
    """
    nodes = patches.relief.shape[1] * patches.fine + 1
    held = take_group(patches, 0, scratch)
    while held > 0:
        lay_nodes(patches.fine, nodes, scratch)
        roll_wheel(nodes, wheel, scratch)
        for group in range(len(bounds) - 1):
            sample_means(samples, bounds[group], bounds[group + 1], scratch.envelope, scratch.rides)
            for lane in range(held):
                for k in range(2):
                    motions[scratch.members[lane], group, k] = scratch.rides[k, lane]
        held = take_group(patches, scratch.members[held - 1] + 1, scratch)
