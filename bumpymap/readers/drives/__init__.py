"""Readers of recorded drives: what inertial sensors, receivers and wheels of a vehicle recorded."""
