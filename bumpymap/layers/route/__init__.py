"""Write what a route leaves: lines, tracks, profiles, pictures, rasters and contours of the reach."""
