"""Drive a vehicle over synthetic terrain and make a calibration. Driving needs the extra ``sim``."""
