"""The graph of ways, read by a port of nav2_route's rules.

github.com/ros-navigation/navigation2, nav2_route: src/plugins/graph_file_loaders/geojson_graph_file_loader.cpp, and
src/route_planner.cpp (which cost of an edge counts).
"""

import json

import numpy as np
import pytest
import rasterio
import shapely
from hypothesis import given, settings, strategies as st
from scipy.ndimage import gaussian_filter, generate_binary_structure, label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra

from bumpymap.core import BadInputError, corners_join
from bumpymap.layers import open_map
from bumpymap.views import ExportSettings, export_map
from bumpymap.views.export.graph import SQUARES, FreeGround, join, line_cost, thin


def load_graph(path):
    """Nodes (points) by id, edges (lines) as start, end, cost; what the loader requires is there."""
    nodes, edges, ids = {}, [], []
    for feature in json.loads(path.read_text())["features"]:
        properties, geometry = feature["properties"], feature["geometry"]
        ids.append(properties["id"])
        if geometry["type"] == "Point":
            assert properties["frame"] == "map"
            nodes[properties["id"]] = tuple(geometry["coordinates"][:2])
        else:
            assert geometry["type"] in {"LineString", "MultiLineString"}
            assert properties["startid"] in nodes
            assert properties["endid"] in nodes
            assert properties["cost"] > 0.0
            assert not properties["overridable"], "scorers would take its place"
            assert geometry["coordinates"][0] == [list(nodes[properties[end]]) for end in ("startid", "endid")]
            edges.append((properties["startid"], properties["endid"], properties["cost"]))
    assert nodes
    assert edges
    assert len(set(ids)) == len(ids)
    assert all(type(one) is int and one >= 0 for one in ids)
    return nodes, edges


def pixel_factor(route_map):
    """Cost of a metre on each pixel, inf where the middle of the vehicle cannot be, as the files say it."""
    with rasterio.open(route_map.folder / "rasters/passage.tif") as file:
        passage = file.read(1)
    field = route_map.read(route_map.window)
    cost = field.rule.cost(field.c_r.astype(float), field.rule.hazard(field.p_fail))
    pixels = route_map.grid.pixels
    cost = np.repeat(np.repeat(np.where(np.isnan(cost), np.inf, cost), pixels, 0), pixels, 1)
    return np.where((passage > 0) & (passage < 255), cost, np.inf)


def places_of(route_map, nodes):
    """Row and column of the pixel of each node, (n, 2), in the rasters of a map; the datum is (0, 0)."""
    window, size = route_map.window, route_map.grid.pixel_size
    x, y = np.array([nodes[number] for number in range(len(nodes))]).T
    bounds = route_map.grid.window_bounds(window)
    return np.floor(np.column_stack([bounds.north - y, x - bounds.west]) / size).astype(int)


@pytest.mark.parametrize("every", [1, 9])
@pytest.mark.parametrize("which", ["easy_map", "route_map"])
def test_the_graph_joins_what_pixels_join_by_edges_over_free_pixels_at_their_cost(request, tmp_path, which, every):
    """Of the largest piece of free pixels, over sides and corners, every area has a node, and no other."""
    site = request.getfixturevalue(which)
    done = export_map(site, tmp_path / "out", ExportSettings(to="graph", every=every, datum=(0.0, 0.0)))
    nodes, edges = load_graph(tmp_path / "out" / "graph.geojson")
    assert done.record["graph"]["nodes"] == len(nodes)
    assert done.record["graph"]["edges"] == len(edges)
    width, size = site.vehicle.width_m, site.grid.pixel_size
    assert corners_join(width, 0.5 * width + 0.1, size)
    factor, pixels = pixel_factor(site), places_of(site, nodes)
    start, end, cost = (np.array(part) for part in zip(*edges, strict=True))
    expected = size * line_cost(factor, pixels[start], pixels[end], corners=True)
    np.testing.assert_allclose(cost, expected, rtol=1e-6)
    back = {(one, other): price for one, other, price in edges}
    assert len(back) == len(edges)
    assert all(back[other, one] == price for one, other, price in edges)
    graph = coo_array((np.ones(len(start)), (start, end)), shape=(len(nodes),) * 2)
    assert connected_components(graph, directed=True, connection="strong")[0] == 1
    pieces = label(np.isfinite(factor), generate_binary_structure(2, 2))[0]
    largest = np.bincount(pieces.ravel())[1:].argmax() + 1
    assert (pieces[tuple(pixels.T)] == largest).all()
    if every == 1:
        side = site.grid.pixels
        reached = np.unique(pixels // side, axis=0)
        open_tiles = np.argwhere((pieces == largest).reshape(site.window.rows, side, -1, side).any(axis=(1, 3)))
        assert np.array_equal(reached, open_tiles)


def test_strips_and_parts_of_any_size_give_the_same_bytes(route_map, tmp_path, monkeypatch):
    about = ExportSettings(to="graph", every=9)
    export_map(route_map, tmp_path / "whole", about)
    monkeypatch.setattr("bumpymap.views.export.graph._STRIP_PIXELS", 1)
    monkeypatch.setattr("bumpymap.views.export.graph._CHUNK", 500)
    export_map(route_map, tmp_path / "parts", about)
    whole, parts = (tmp_path / name / "graph.geojson" for name in ("whole", "parts"))
    assert whole.read_bytes() == parts.read_bytes()


CELL = st.integers(0, 11)


def integral(factor, start, stop):
    """The cost of a line by cutting it with the square of every tile (GEOS)."""
    line = shapely.LineString([np.array(start)[::-1] + 0.5, np.array(stop)[::-1] + 0.5])
    rows, cols = np.indices(factor.shape).reshape(2, -1)
    squares = shapely.box(cols, rows, cols + 1, rows + 1)
    touched = shapely.intersects(squares, line)
    if not np.isfinite(factor.ravel()[touched]).all():
        return np.inf
    return float((shapely.length(shapely.intersection(squares[touched], line)) * factor.ravel()[touched]).sum())


@given(st.integers(0, 2**32 - 1), CELL, CELL, CELL, CELL, st.sampled_from([0.0, 0.03, 0.15]))
@settings(max_examples=100)
def test_the_cost_of_a_line_is_the_integral_over_every_tile(seed, row, col, to_row, to_col, closed):
    rng = np.random.default_rng(seed)
    factor = rng.uniform(1.0, 9.0, (12, 12))
    factor[rng.random(factor.shape) < closed] = np.inf
    ends = np.array([[row, col]]), np.array([[to_row, to_col]])
    found = line_cost(factor, *ends)[0]
    expected = integral(factor, (row, col), (to_row, to_col)) if (row, col) != (to_row, to_col) else 0.0
    assert found == pytest.approx(expected, rel=1e-9)
    assert line_cost(factor, *ends[::-1])[0] == pytest.approx(found, rel=1e-12)


def make_lattice(factor, largest, origin=(0, 0), *, corners=False):
    """The graph of tiles of one pixel each that cost ``factor``."""
    free = np.isfinite(factor)
    ground = FreeGround(factor, 1, lambda rows, cols: free[rows.start : rows.stop, cols.start : cols.stop], corners)
    return join(ground, thin(ground, largest, origin)[1])


def ways(lattice):
    """Cost of the cheapest way between any two nodes."""
    number = len(lattice.row)
    return dijkstra(coo_array((lattice.cost, (lattice.first, lattice.second)), shape=(number, number)), directed=False)


def field(seed, closed, size=(40, 50)):
    """Smooth costs from 1 upward; patches of closed ground, and single closed tiles."""
    rng = np.random.default_rng(seed)
    factor = 1.0 + gaussian_filter(rng.gamma(1.0, 8.0, size), 3.0)
    patches = gaussian_filter(rng.random(size), 1.0)
    factor[(patches < np.quantile(patches, closed)) | (rng.random(size) < closed / 10)] = np.inf
    return factor


def test_on_level_ground_a_way_through_the_graph_is_at_most_8_percent_too_long():
    lattice = make_lattice(np.ones((90, 90)), 9)
    assert len(lattice.row) == 100
    straight = np.hypot(*(axis[:, None] - axis for axis in (lattice.row, lattice.col)))
    ratio = ways(lattice)[straight > 0] / straight[straight > 0]
    assert ratio.min() >= 1.0 - 1e-12
    assert ratio.max() <= 1.0 / np.cos(np.pi / 8) + 1e-12  # 8 directions


@pytest.mark.parametrize("corners", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_thinning_cuts_nothing_off(seed, corners):
    """What is connected over sides of tiles, or over corners too, is connected in the graph, and nothing else is."""
    factor = field(seed, 0.6 if corners else 0.45)
    parts, count = label(np.isfinite(factor), generate_binary_structure(2, 1 + corners))
    assert count > 1
    sizes = np.bincount(parts[parts > 0])
    for largest in SQUARES:
        lattice = make_lattice(factor, largest, (3, 8), corners=corners)
        assert np.unique(parts[lattice.row, lattice.col]).tolist() == [sizes.argmax()]
        assert lattice.tiles_left_out == sizes.sum() - sizes.max()


def test_what_gives_no_graph(easy_map, make_map, write_map, tmp_path, monkeypatch):
    lone = open_map(write_map(make_map([5, 9], [5, 9], [0, 0], [0, 0], easy=True), tmp_path / "lone"))
    with pytest.raises(BadInputError, match="no two nodes are connected"):
        export_map(lone, tmp_path / "out", ExportSettings(to="graph"))
    monkeypatch.setattr("bumpymap.views.export.graph._MAX_NODES", 10)
    with pytest.raises(BadInputError, match=r"`every=1`.*larger"):
        export_map(easy_map, tmp_path / "out", ExportSettings(to="graph", every=1))
    monkeypatch.setattr("bumpymap.views.export.graph._MAX_TILES", 10)
    with pytest.raises(BadInputError, match="480 tiles"):
        export_map(easy_map, tmp_path / "out", ExportSettings(to="graph"))
    assert not (tmp_path / "out").exists()
