"""The regions of small maps and their files."""

from cost_maps import table_of

from bumpymap.layers.regions import dissolve
from bumpymap.layers.vector import GeoJsonCoordinates, flatgeobuf_writer, geojson_writer


def regions_of(cost_map):
    """Regions of a small map, which come at once."""
    (regions,) = dissolve(table_of(cost_map))
    return regions


def write_geojson(regions, path, *, local, about=None):
    place = GeoJsonCoordinates.of(regions.placement, local=local)
    with geojson_writer(path, place, about) as add:
        add(regions)


def write_flatgeobuf(regions, path):
    with flatgeobuf_writer(path, regions.placement) as add:
        add(regions)
