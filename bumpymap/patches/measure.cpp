// The points of tiles in, measurements of tiles out.
//
// Points of a tile come in a canonical order (see bumpytiles/grouping.py), and the first k are a random sample of them.
// They are taken from the middle of the tile and its lowest point, so a tile that lies elsewhere has the same bits. Its
// planes are found (tile_planes.hpp): slope, strays and spread are those of the robust plane, which needs no draw, the
// residual that of RANSAC. Points far from all others are set aside, the rest fall into pixels, and the plane comes off
// these (heightmap.hpp). Ours, but for the residual: see docs/pages/measuring.md.
#include <nanobind/stl/tuple.h>

#include <numbers>

#include "bumpymap/patches/heightmap.hpp"
#include "bumpymap/patches/points_by_tile.hpp"
#include "bumpymap/patches/tile_planes.hpp"

namespace bumpy {
namespace {

// Columns of the scalars.
enum Scalar : Index { Z_MIN, Z_MAX, Z_VARIANCE, RESIDUAL, SLOPE, Z_RANGE, COVERAGE, RELIEF, STRAYS };

// Points of a tile in single precision.
struct SinglePoints {
    std::vector<float> x, y, z;

    explicit SinglePoints(const CentredPoints<double>& points)
        : x(points.x.begin(), points.x.end()),
          y(points.y.begin(), points.y.end()),
          z(points.z.begin(), points.z.end()) {}

    CentredPoints<float> all() const { return {view(x), view(y), view(z)}; }
};

// Finds the planes of centred points; fills residual, slope, and the distances to the robust plane, which it returns;
// heights where there is none.
Plane find_planes(
    const CentredPoints<double>& points, double threshold, std::vector<double>& distances, Array<double> scalars) {
    const SinglePoints singles(points);
    const Plane robust = robust_plane(points, singles.all());
    if (!robust.is_found()) {
        distances.assign(points.z.begin(), points.z.end());
        return robust;
    }
    const auto above = [&points](const Plane& plane, Index i) {
        return plane.above(points.x[i], points.y[i], points.z[i]);
    };
    const Plane drawn = ransac_plane(points, singles.all(), robust, threshold);
    const double sum = sum_in_lanes(points.size(), [&](Index i) { return std::abs(above(drawn, i)); });
    scalars[RESIDUAL] = sum / static_cast<double>(points.size());
    for (Index i = 0; i < points.size(); ++i) distances[i] = above(robust, i);
    scalars[SLOPE] = std::acos(std::min(1.0, robust.c)) * (180.0 / std::numbers::pi);
    return robust;
}

// Measures a tile. Its points are taken from its middle and their mean height.
void measure_tile(
    const TilePoints& points, Index t, const FeatureSettings& settings, Index depth, Array<double> scalars,
    const Heightmap& out) {
    const Index first = points.starts[t], last = points.starts[t + 1], n = last - first, size = out.heights.shape[0];
    const auto east = points.easting.slice(first, last), north = points.northing.slice(first, last);
    const auto up = points.upward.slice(first, last);
    const double side = points.grid.tile_size;
    const double west = static_cast<double>(points.col[t]) * side, south = static_cast<double>(points.row[t]) * side;
    std::vector<double> x(n), y(n), z(n), distances(n), levels(size * size);
    shift(east, west, side / 2.0, view(x));
    shift(north, south, side / 2.0, view(y));
    const auto [lowest, highest] = extremes(up);
    scalars[Z_MIN] = lowest;
    scalars[Z_MAX] = highest;
    shift(up, lowest, 0.0, view(distances));
    const double mean = lowest + centre(view(distances), view(z));
    scalars[Z_VARIANCE] = sum_in_lanes(n, [&](Index i) { return z[i] * z[i]; }) / static_cast<double>(n);

    const CentredPoints<double> centred{view(x), view(y), view(z)};
    const Plane plane = find_planes(centred, settings.ransac_threshold, distances, scalars);
    std::vector<std::int32_t> pixels(n);
    find_pixels(east, north, west, south, side, size, view(pixels));
    const auto [low, high, strays] = stray_bounds(view(distances), settings.stray_gap, settings.stray_points);
    if (strays > 0)
        for (Index i = 0; i < n; ++i)
            if (!(low <= distances[i] && distances[i] <= high)) pixels[i] = static_cast<std::int32_t>(size * size);
    std::vector<PixelSums> sums(size * size + 1);  // the last one takes the strays
    sum_by_pixel(view(pixels), centred, plane, view(sums));
    const Array<double, 2> level{levels.data(), {size, size}};
    const auto [known, range] = fill_heightmap(view(sums), mean, level, out);
    scalars[Z_RANGE] = range;
    scalars[COVERAGE] = static_cast<double>(known) / static_cast<double>(size * size);
    scalars[RELIEF] = fill_relief(level, depth, known == size * size, out.relief);
    scalars[STRAYS] = static_cast<double>(strays);
}

// Measures every tile that has points; the others get NaN, and no points. `depth`: deepest hole that is filled, px.
void measure_tiles(
    TilePoints points, FeatureSettings settings, Index depth, Array<double, 2> out, Array<float, 3> heights,
    Array<float, 3> variance, Array<float, 3> relief, Array<std::int32_t, 3> counts) {
    for (Index t = 0; t < points.tiles(); ++t) {
        const Array<double> scalars = out.at(t);
        std::fill(scalars.begin(), scalars.end(), not_a_number);
        const Heightmap maps{heights.at(t), variance.at(t), relief.at(t), counts.at(t)};
        if (points.starts[t] < points.starts[t + 1]) {
            measure_tile(points, t, settings, depth, scalars, maps);
            continue;
        }
        for (const Array<float, 2>& map : {maps.heights, maps.variance, maps.relief}) set_all(map, unknown_height);
        set_all(maps.count, 0);
    }
}

}  // namespace
}  // namespace bumpy

void bind_measure(nb::module_& module) {
    using namespace bumpy;
    BUMPY_LOOP(module, measure_tiles);
    BUMPY_LOOP(module, stray_bounds);
    module.def("fill_holes", &fill_all_holes<double>, free_interpreter());
}
