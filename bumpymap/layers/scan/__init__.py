"""Write the files of a scan run: polygons, clouds, pictures, a table of sectors, an accumulated survey."""
