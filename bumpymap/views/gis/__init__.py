"""Write styles and a project with which QGIS shows the layers of a map as they are meant."""
