"""Write a map for robots: occupancy grids and masks for Nav2, a grid_map message, a mission plan, cost on pixels."""
