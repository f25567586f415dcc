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

struct MeasureSettings {
    double tile_size, threshold, gap;
    Index most_strays, depth;
};

struct TileMeasures {
    Array<double, 2> scalars;
    Array<float, 3> heights, variance, relief;
    Array<std::int32_t, 3> pixel_count;

    Heightmap at(Index t) const { return {heights.at(t), variance.at(t), relief.at(t), pixel_count.at(t)}; }
};

// Columns of the scalars.
enum Scalar : Index { Z_MIN, Z_MAX, Z_VARIANCE, RESIDUAL, SLOPE, Z_RANGE, COVERAGE, RELIEF, STRAYS };

// Coordinates of the points of a tile, m.
template <class Number>
class PointBuffer {
  public:
    explicit PointBuffer(Index points) : room(points), numbers(static_cast<std::size_t>(3 * points)) {}

    Array<Number> axis(Index number, Index count) { return {numbers.data() + number * room, {count}}; }
    CentredPoints<Number> first(Index count) { return {axis(0, count), axis(1, count), axis(2, count)}; }

    void copy(const CentredPoints<double>& points) {
        for (const auto& [number, given] : {std::pair{0, points.x}, {1, points.y}, {2, points.z}}) {
            const Array<Number> own = axis(number, given.size());
            for (Index i = 0; i < given.size(); ++i) own[i] = static_cast<Number>(given[i]);
        }
    }

  private:
    Index room;
    std::vector<Number> numbers;
};

class TileMeter {
  public:
    TileMeter(const MeasureSettings& limits, Index most, Index pixels_of_side)
        : settings(limits),
          size(pixels_of_side),
          doubles(most),
          singles(most),
          distances(static_cast<std::size_t>(most)),
          pixels(static_cast<std::size_t>(most)),
          sums(static_cast<std::size_t>(size * size + 1)),
          levels(static_cast<std::size_t>(size * size)) {}

    void measure(const PointsByTile& points, Index t, Array<double> scalars, const Heightmap& out) {
        const Index first = points.starts[t], last = points.starts[t + 1], n = last - first;
        const Array<double> distance{distances.data(), {n}};
        const Array<std::int32_t> pixel{pixels.data(), {n}};
        const auto east = points.easting.slice(first, last), north = points.northing.slice(first, last);
        const double side = settings.tile_size;
        const double west = static_cast<double>(points.col[t]) * side,
                     south = static_cast<double>(points.row[t]) * side;
        find_pixels(east, north, west, south, side, size, pixel);
        const double mean = centre_points(east, north, points.upward.slice(first, last), west, south, scalars);
        const Plane plane = find_planes(n, distance, scalars);
        const auto [low, high, strays] = stray_bounds(distance, settings.gap, settings.most_strays);
        if (strays > 0)
            for (Index i = 0; i < n; ++i)
                if (!(low <= distance[i] && distance[i] <= high)) pixel[i] = static_cast<std::int32_t>(size * size);
        const Array<PixelSums> by_pixel{sums.data(), {size * size + 1}};
        const Array<double, 2> level{levels.data(), {size, size}};
        sum_by_pixel(pixel, doubles.first(n), plane, by_pixel);
        const auto [known, range] = fill_heightmap(by_pixel, mean, level, out);
        scalars[Z_RANGE] = range;
        scalars[COVERAGE] = static_cast<double>(known) / static_cast<double>(size * size);
        scalars[RELIEF] = fill_relief(level, settings.depth, known == size * size, out.relief);
        scalars[STRAYS] = static_cast<double>(strays);
    }

  private:
    // Takes the points from the middle of the tile and their mean height, which it returns.
    double centre_points(
        Array<const double> east, Array<const double> north, Array<const double> up, double west, double south,
        Array<double> scalars) {
        const Index n = up.size();
        const Array<double> above{distances.data(), {n}}, z = doubles.axis(2, n);
        shift(east, west, settings.tile_size / 2.0, doubles.axis(0, n));
        shift(north, south, settings.tile_size / 2.0, doubles.axis(1, n));
        const auto [low, high] = extremes(up);
        scalars[Z_MIN] = low;
        scalars[Z_MAX] = high;
        shift(up, low, 0.0, above);
        const double mean = low + centre(above, z);
        scalars[Z_VARIANCE] = sum_in_lanes(n, [=](Index i) { return z[i] * z[i]; }) / static_cast<double>(n);
        singles.copy(doubles.first(n));
        return mean;
    }

    // Finds the planes; fills residual, slope, and the distances to the robust plane, which it returns; heights where
    // there is none.
    Plane find_planes(Index n, Array<double> distance, Array<double> scalars) {
        const CentredPoints<double> points = doubles.first(n);
        const Plane robust = robust_plane(points, singles.first(n));
        if (!robust.is_found()) {
            std::copy_n(points.z.data, n, distance.data);
            return robust;
        }
        const auto above = [&points](const Plane& plane, Index i) {
            return plane.above(points.x[i], points.y[i], points.z[i]);
        };
        const Plane drawn = ransac_plane(points, singles.first(n), robust, settings.threshold);
        const double sum = sum_in_lanes(n, [&](Index i) { return std::abs(above(drawn, i)); });
        scalars[RESIDUAL] = sum / static_cast<double>(n);
        for (Index i = 0; i < n; ++i) distance[i] = above(robust, i);
        scalars[SLOPE] = std::acos(std::min(1.0, robust.c)) * (180.0 / std::numbers::pi);
        return robust;
    }

    const MeasureSettings settings;
    const Index size;
    PointBuffer<double> doubles;
    PointBuffer<float> singles;
    std::vector<double> distances;
    std::vector<std::int32_t> pixels;
    std::vector<PixelSums> sums;  // by pixel; the last one takes the strays
    std::vector<double> levels;
};

// The plane that RANSAC finds in centred points.
std::tuple<double, double, double, double> ransac_plane_of(
    Array<const double> x, Array<const double> y, Array<const double> z, double threshold) {
    const CentredPoints<double> points{x, y, z};
    PointBuffer<float> buffer(points.size());
    buffer.copy(points);
    const CentredPoints<float> singles = buffer.first(points.size());
    const Plane plane = ransac_plane(points, singles, robust_plane(points, singles), threshold);
    return {plane.a, plane.b, plane.c, plane.d};
}

// Measures every tile that has points; the others get NaN, and no points.
void measure_tiles(PointsByTile points, MeasureSettings settings, TileMeasures out) {
    TileMeter meter(settings, points.most_points(), out.heights.shape[1]);
    for (Index t = 0; t < points.tiles(); ++t) {
        const Array<double> scalars = out.scalars.at(t);
        std::fill(scalars.begin(), scalars.end(), not_a_number);
        const Heightmap maps = out.at(t);
        if (points.starts[t] < points.starts[t + 1]) {
            meter.measure(points, t, scalars, maps);
            continue;
        }
        for (const Array<float, 2>& map : {maps.heights, maps.variance, maps.relief}) set_all(map, unknown_height);
        set_all(maps.count, 0);
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::MeasureSettings, tile_size, threshold, gap, most_strays, depth)
BUMPY_RECORD(bumpy::TileMeasures, scalars, heights, variance, relief, pixel_count)

void bind_measure(nb::module_& module) {
    using namespace bumpy;
    BUMPY_LOOP(module, measure_tiles);
    BUMPY_LOOP(module, ransac_plane_of);
    BUMPY_LOOP(module, stray_bounds);
    module.def("fill_holes", &fill_holes<double>, free_interpreter());
}
