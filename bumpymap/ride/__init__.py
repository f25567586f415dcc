"""The ride model: geometry rolls the vehicle over a patch, a calibration corrects what geometry leaves out."""

from bumpymap.ride.correction import Correction, Prediction, told_from_noise
from bumpymap.ride.fitting import MOST_FAILED, DrivenPatches, NoisyPatches, fit_correction
from bumpymap.ride.geometry import Rides, roll_over
from bumpymap.ride.noise import CleanPatches, take_noise_off
from bumpymap.ride.operator import RideOperator
from bumpymap.ride.rate import RideModel

__all__ = [
    "MOST_FAILED",
    "CleanPatches",
    "Correction",
    "DrivenPatches",
    "NoisyPatches",
    "Prediction",
    "RideModel",
    "RideOperator",
    "Rides",
    "fit_correction",
    "roll_over",
    "take_noise_off",
    "told_from_noise",
]
