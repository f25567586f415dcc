"""The ride model: roll the vehicle's geometry over a patch, then correct the result with a calibration."""
