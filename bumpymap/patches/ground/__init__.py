"""Find the ground points of a survey without ground classification."""
