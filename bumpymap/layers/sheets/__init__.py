"""Write a large map in sheets: folders of layers on the shared grid, and virtual rasters over all of them."""
