"""The vehicle workshop: drives a vehicle over simulated terrain and hands over a calibration.

Driving needs the extra ``sim`` (dartpy); reading profiles does not.
"""
