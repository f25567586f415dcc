// From the points of a tile to its pixels: heights, their spread, and relief. Ours; see measure.cpp for the whole.
// Planes through points, too, and how RANSAC (Fischler and Bolles 1981) draws them.
#pragma once

#include <bit>
#include <optional>

#include "bumpymap/core/fill_holes.hpp"
#include "bumpymap/patches/sums.hpp"

namespace bumpy {

// Unit normal (a, b, c), upward, and d of a x + b y + c z + d = 0; all zero where there is no plane.
struct Plane {
    double a = 0.0, b = 0.0, c = 0.0, d = 0.0;

    bool is_found() const { return a != 0.0 || b != 0.0 || c != 0.0; }

    double above(double x, double y, double z) const { return a * x + b * y + c * z + d; }
};

// Coordinates of points around zero, m.
template <class Number>
struct CentredPoints {
    Array<const Number> x, y, z;

    Index size() const { return x.size(); }

    CentredPoints slice(Index first, Index last) const {
        return {x.slice(first, last), y.slice(first, last), z.slice(first, last)};
    }
};

// Twice the least area that the three points of a candidate must span, m^2.
constexpr double least_area = 2e-3;
// Accepted probability that no candidate was drawn from inliers alone.
constexpr double miss_probability = 1e-4;

// The plane through three points; none where they are nearly on a line.
inline Plane plane_through(const CentredPoints<double>& points, Index i, Index j, Index k) {
    const auto& [x, y, z] = points;
    const double ux = x[j] - x[i], uy = y[j] - y[i], uz = z[j] - z[i];
    const double vx = x[k] - x[i], vy = y[k] - y[i], vz = z[k] - z[i];
    double a = uy * vz - uz * vy, b = uz * vx - ux * vz, c = ux * vy - uy * vx;
    double length = std::sqrt(a * a + b * b + c * c);
    if (length < least_area) return {};
    if (c < 0.0) length = -length;
    a /= length;
    b /= length;
    c /= length;
    return {a, b, c, -(a * x[i] + b * y[i] + c * z[i])};
}

// Draws of which one likely has inliers alone, or `most`; `clean` is the chance that a draw has: over 0, below 1.
inline Index draws_needed(double clean, Index most) {
    return std::min(most, 1 + static_cast<Index>(std::log(miss_probability) / std::log(1.0 - clean)));
}

constexpr float unknown_height = std::numeric_limits<float>::quiet_NaN();

// Relief below this is rounding, not ground, m.
constexpr double least_relief = 1e-6;
// A plane whose upward normal is less than this (steeper than 78 degrees) is a wall, not the slope of the ground.
constexpr double steepest = 0.2;
// Pixels whose spreads have a determinant of less, as a share of their product, lie on a line.
constexpr double line_of_pixels = 1e-9;

template <class Number>
void set_all(Array<Number, 2> pixels, Number value) {
    std::fill_n(pixels.data, pixels.count(), value);
}

// Tangents.
struct Slopes {
    double x, y;
};

// Slopes of a least-squares plane from the sums of points about their middle; none where they lie on a line: their
// determinant is less than a share of the product of their spreads.
inline std::optional<Slopes> slopes_of(double xx, double xy, double yy, double xz, double yz, double share) {
    const double det = xx * yy - xy * xy;
    if (det <= share * xx * yy) return std::nullopt;
    return Slopes{(xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det};
}

// Sums of points for a least-squares plane, heights z over x and y.
struct PlaneSums {
    double n = 0.0, x = 0.0, y = 0.0, z = 0.0, xx = 0.0, xy = 0.0, yy = 0.0, xz = 0.0, yz = 0.0;

    void add(double east, double north, double up) {
        n += 1.0;
        x += east;
        y += north;
        z += up;
        xx += east * east;
        xy += east * north;
        yy += north * north;
        xz += east * up;
        yz += north * up;
    }

    // `ridge` is added to the spread of each point.
    std::optional<Slopes> slopes(double share, double ridge = 0.0) const {
        const double mx = x / n, my = y / n;
        return slopes_of(
            xx - x * mx + n * ridge, xy - x * my, yy - y * my + n * ridge, xz - mx * z, yz - my * z, share);
    }
};

// Takes the least-squares plane over the known pixels off heights [m] in place; NaN stays NaN. Returns false, and
// changes nothing, where the known pixels do not span a plane.
inline bool detrend(Array<double, 2> heights) {
    const Index rows = heights.shape[0], cols = heights.shape[1];
    const double middle = 0.5 * static_cast<double>(rows - 1), centre = 0.5 * static_cast<double>(cols - 1);
    PlaneSums sums;
    for (Index r = 0; r < rows; ++r) {
        PlaneSums row;
        for (Index c = 0; c < cols; ++c) {
            const double height = heights(r, c);
            const bool known = !std::isnan(height);  // tests without a branch
            const double x = known ? static_cast<double>(c) - centre : 0.0, h = known ? height : 0.0;
            row.n += known ? 1.0 : 0.0;
            row.x += x;
            row.z += h;
            row.xx += x * x;
            row.xz += x * h;
        }
        const double y = static_cast<double>(r) - middle;
        sums.n += row.n;
        sums.x += row.x;
        sums.y += y * row.n;
        sums.z += row.z;
        sums.xx += row.xx;
        sums.xy += y * row.x;
        sums.yy += y * y * row.n;
        sums.xz += row.xz;
        sums.yz += y * row.z;
    }
    if (sums.n < 3.0) return false;
    const std::optional<Slopes> slopes = sums.slopes(line_of_pixels);
    if (!slopes) return false;
    const double mx = sums.x / sums.n, my = sums.y / sums.n, mz = sums.z / sums.n;
    for (Index r = 0; r < rows; ++r) {
        const double level = mz + slopes->y * (static_cast<double>(r) - middle - my);
        for (Index c = 0; c < cols; ++c) heights(r, c) -= level + slopes->x * (static_cast<double>(c) - centre - mx);
    }
    return true;
}

// Writes each point's pixel, row * size + column with the north row first.
inline void find_pixels(
    Array<const double> easting, Array<const double> northing, double west, double south, double tile_size, Index size,
    Array<std::int32_t> out) {
    const auto last = static_cast<std::int32_t>(size - 1), width = static_cast<std::int32_t>(size);
    const auto pixels = static_cast<double>(size);
    for (Index i = 0; i < easting.size(); ++i) {
        const auto c = static_cast<std::int32_t>(pixels_from(west, easting[i], tile_size, pixels));
        const auto r = static_cast<std::int32_t>(pixels_from(south, northing[i], tile_size, pixels));
        out[i] = (last - std::min(last, r)) * width + std::min(last, c);
    }
}

// Of the points of a pixel: their number, sum of z, of squared heights above the plane, of the plane's height.
struct PixelSums {
    double count, height, square, slope;
};

inline void sum_by_pixel(
    Array<const std::int32_t> pixel, const CentredPoints<double>& points, const Plane& plane, Array<PixelSums> sums) {
    std::fill(sums.begin(), sums.end(), PixelSums{});
    const bool is_wall = !(plane.c > steepest);
    const double east = is_wall ? 0.0 : -plane.a / plane.c, north = is_wall ? 0.0 : -plane.b / plane.c;
    for (Index i = 0; i < points.size(); ++i) {
        const double z = points.z[i], slope = east * points.x[i] + north * points.y[i];
        PixelSums& own = sums[pixel[i]];
        own.count += 1.0;
        own.height += z;
        own.square += (z - slope) * (z - slope);
        own.slope += slope;
    }
}

// Arrays of a tile that are filled, (pixels, pixels) each.
struct Heightmap {
    Array<float, 2> heights, variance, relief;
    Array<std::int32_t, 2> count;
};

struct KnownPixels {
    Index number;
    double range;  // of their heights, m
};

// Fills mean height, population variance about the plane and number of the points in each pixel; NaN where none fell.
// `level` takes heights above `mean`, without the plane: on a slope the mean of some points is not the height of the
// pixel's middle, and where they fell by chance, the slope would look rough.
inline KnownPixels fill_heightmap(
    Array<const PixelSums> sums, double mean, Array<double, 2> level, const Heightmap& out) {
    Index known = 0;
    double low = infinite, high = -infinite;
    for (Index k = 0; k < level.count(); ++k) {
        const auto& [count, height, square, slope] = sums[k];
        const double m = height / count;  // 0 / 0: NaN, and so are those that follow from it
        const double above = m - slope / count;
        const double variance = square / count - above * above;
        level.data[k] = above;
        out.count.data[k] = static_cast<std::int32_t>(count);
        out.heights.data[k] = static_cast<float>(mean + m);
        out.variance.data[k] = static_cast<float>(variance < 0.0 ? 0.0 : variance);  // NaN stays
        known += count > 0.0;
        low = m < low ? m : low;  // NaN does not count
        high = m > high ? m : high;
    }
    return {known, high - low};
}

// Writes plane-removed, hole-filled heights; returns their range, NaN where holes are too deep. `level` is changed.
// Filled holes move the plane, so it is taken off once more.
inline double fill_relief(Array<double, 2> level, Index depth, bool is_complete, Array<float, 2> relief) {
    if (!detrend(level) || (!is_complete && fill_all_holes(level, depth) > 0)) {
        set_all(relief, unknown_height);
        return not_a_number;
    }
    if (!is_complete) detrend(level);
    const auto [low, high] = extremes({level.data, {level.count()}});
    if (high - low < least_relief) {
        set_all(relief, 0.0F);
        return 0.0;
    }
    for (Index k = 0; k < level.count(); ++k) relief.data[k] = static_cast<float>(level.data[k]);
    return high - low;
}

// Share of nine parts, a bit each, row by row, that hold a point; 0 if four that form a square hold none.
inline double share_of_parts(int seen) {
    constexpr int square = 0b000011011;
    for (const int corner : {0, 1, 3, 4})
        if ((seen & (square << corner)) == 0) return 0.0;
    return std::popcount(static_cast<unsigned>(seen)) / 9.0;
}

}  // namespace bumpy
