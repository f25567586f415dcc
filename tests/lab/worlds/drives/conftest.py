"""Motions in closed form."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensed_drives import TrueDrive

RATE_HZ = 500.0
ORIGIN = np.array([480_000.0, 2_136_000.0, 2300.0])


def at_rest(seconds=20.0, yaw=0.0, pitch=0.0, roll=0.0):
    """A vehicle at rest; pitch is positive with its nose down."""
    count = round(seconds * RATE_HZ)
    turned = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    none = np.zeros((count, 3))
    place = np.tile(ORIGIN, (count, 1))
    return TrueDrive(RATE_HZ, place, np.tile(turned, (count, 1, 1)), none, none, np.zeros((count, 2)))


def driven_circle(speed, turn, seconds=20.0, pitch_rate=0.0):
    """A drive in a level circle, or straight to the east; ``pitch_rate`` is only what the sensor says."""
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    heading = turn * time
    if turn:
        place = speed / turn * np.stack([np.sin(heading), 1 - np.cos(heading), 0 * time], axis=1)
    else:
        place = np.stack([speed * time, 0 * time, 0 * time], axis=1)
    rates = np.tile([0.0, pitch_rate, turn], (len(time), 1))
    velocity = np.tile([speed, 0.0, 0.0], (len(time), 1))
    rotation = Rotation.from_euler("Z", heading[:, None]).as_matrix()
    wheels = speed + np.outer(np.ones(len(time)), [-0.5, 0.5]) * turn
    return TrueDrive(RATE_HZ, place + ORIGIN, rotation, rates, velocity, wheels)


@pytest.fixture(scope="session")
def standing():
    """Makes vehicles at rest."""
    return at_rest


@pytest.fixture(scope="session")
def circle():
    """Makes drives in circles and straight on."""
    return driven_circle
