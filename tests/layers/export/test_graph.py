"""The graph of ways, read by a port of nav2_route's rules.

github.com/ros-navigation/navigation2, nav2_route: src/plugins/graph_file_loaders/geojson_graph_file_loader.cpp, and
src/route_planner.cpp (which cost of an edge counts).
"""

import json

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra

from bumpymap.core import BadInputError
from bumpymap.layers import ExportSettings, export_map, open_map
from bumpymap.layers.export.lattice import default_spacing, make_lattice, thin_tiles
from bumpymap.layers.export.line_cost import line_cost


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


def closed_factor(route_map):
    barred, cost = route_map.read_cost(route_map.window)
    return np.where(barred == 0, cost, np.inf).astype(float)


@pytest.mark.parametrize("every", [1, 3])
def test_every_edge_crosses_only_passable_tiles_at_its_cost(easy_map, tmp_path, every):
    done = export_map(easy_map, tmp_path / "out", ExportSettings(to="graph", every=every, datum=(0.0, 0.0)))
    nodes, edges = load_graph(tmp_path / "out" / "graph.geojson")
    assert done.record["graph"]["nodes"] == len(nodes)
    assert done.record["graph"]["edges"] == len(edges)
    window, factor = easy_map.window, closed_factor(easy_map)
    place = np.array([nodes[number] for number in range(len(nodes))]) / 3.0 - 0.5
    row = np.rint(window.row + window.rows - 1 - place[:, 1]).astype(int)
    col = np.rint(place[:, 0] - window.col).astype(int)
    np.testing.assert_allclose(place[:, 1], window.row + window.rows - 1 - row, atol=1e-6)
    tiles = np.stack([row, col], axis=1)
    assert np.isfinite(factor[row, col]).all()
    start, end, cost = (np.array(part) for part in zip(*edges, strict=True))
    np.testing.assert_allclose(cost, 3.0 * line_cost(factor, tiles[start], tiles[end]), rtol=1e-6)
    back = {(one, other): price for one, other, price in edges}
    assert all(back[other, one] == price for one, other, price in edges)
    graph = coo_array((np.ones(len(start)), (start, end)), shape=(len(nodes),) * 2)
    assert connected_components(graph, directed=True, connection="strong")[0] == 1


def test_on_level_ground_a_way_through_the_graph_is_at_most_8_percent_too_long():
    lattice = make_lattice(np.ones((40, 40)), 4, (0, 0))
    assert len(lattice.row) == 100
    number = len(lattice.row)
    ways = dijkstra(coo_array((lattice.cost, (lattice.first, lattice.second)), shape=(number, number)), directed=False)
    straight = np.hypot(*(axis[:, None] - axis for axis in (lattice.row, lattice.col)))
    ratio = ways[straight > 0] / straight[straight > 0]
    assert ratio.min() >= 1.0 - 1e-12
    assert ratio.max() <= 1.0 / np.cos(np.pi / 8) + 1e-12  # 8 directions


def test_nodes_are_nearest_to_the_middle_of_their_square_and_crops_share_them():
    is_open = np.random.default_rng(3).random((30, 40)) < 0.6
    row, col, square = thin_tiles(is_open, 5, (7, -3))
    assert is_open[row, col].all()
    assert len({tuple(one) for one in square.tolist()}) == len(square)
    rows, cols = np.nonzero(is_open)
    for number in range(len(row)):
        inside = ((rows + 7) // 5 == square[number, 0]) & ((cols - 3) // 5 == square[number, 1])
        middle = square[number] * 5 + 2.0 - (7, -3)
        off = np.hypot(rows[inside] - middle[0], cols[inside] - middle[1])
        assert np.hypot(row[number] - middle[0], col[number] - middle[1]) == off.min()
    cut_row, cut_col, _ = thin_tiles(is_open[8:23, 8:33], 5, (15, 5))  # whole squares
    whole = set(zip(row.tolist(), col.tolist(), strict=True))
    assert {(r + 8, c + 8) for r, c in zip(cut_row.tolist(), cut_col.tolist(), strict=True)} <= whole


def test_islands_are_left_out_and_told():
    factor = np.full((9, 9), np.inf)
    factor[:3] = 1.0
    factor[5:7, 5:7] = 1.0  # an island
    factor[3, 3] = factor[4, 4] = 1.0  # touch at corners only
    lattice = make_lattice(factor, 1, (0, 0))
    assert len(lattice.row) == 28
    assert lattice.left_out == 5
    assert (lattice.row <= 3).all()


def test_the_usual_spacing_bounds_the_number_of_nodes():
    is_open = np.ones((100, 120), np.bool_)
    for most in (50, 700, 12_000):
        every = default_spacing(is_open, most, (0, 0))
        assert len(thin_tiles(is_open, every, (0, 0))[0]) <= most
        assert every == 1 or len(thin_tiles(is_open, every - 1, (0, 0))[0]) > most


def test_what_gives_no_graph(easy_map, make_map, write_map, tmp_path, monkeypatch):
    lone = open_map([write_map(make_map([5, 9], [5, 9], [0, 0], [0, 0], easy=True), tmp_path / "lone")])
    with pytest.raises(BadInputError, match="no two nodes are connected"):
        export_map(lone, tmp_path / "out", ExportSettings(to="graph"))
    monkeypatch.setattr("bumpymap.layers.export.graph._MAX_NODES", 10)
    with pytest.raises(BadInputError, match="larger `every` than 1"):
        export_map(easy_map, tmp_path / "out", ExportSettings(to="graph", every=1))
    monkeypatch.setattr("bumpymap.layers.export.graph._MAX_TILES", 10)
    with pytest.raises(BadInputError, match="480 tiles"):
        export_map(easy_map, tmp_path / "out", ExportSettings(to="graph"))
    assert not (tmp_path / "out").exists()
