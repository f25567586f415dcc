// Straight lines over square tiles: their cost, their distance to closed tiles.
//
// Field coordinates (r, c) of a window are in tiles: r from its north edge southwards, c from its west edge eastwards.
// A tile is closed where its cost is infinite; everything outside the window is closed. Costs are (rows, cols, axes):
// of one axis, alike in all directions, or along the eight of AXES_DEG. Between two axes cost is linear in the slope of
// the segment against the rows or columns, whichever it is nearer to: unlike angles, that gives a turned or mirrored
// map the same bits. What climbing, descending and driving across a slope cost is added for the very direction of the
// segment; the cost of a direction that is too steep across is infinite.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "bumpytiles/bindings.hpp"

namespace bumpy {

constexpr double infinite = std::numeric_limits<double>::infinity();
// Pieces below this length, tiles, are rounding errors of a line through a corner of four tiles.
constexpr double sliver = 1e-12;
// Distances to closed tiles may be shorter than the margin by this, tiles, but not by more than half of it.
constexpr double rounding = 1e-9;
// Bits: which end of a segment is the start or the goal, and may be nearer to closed tiles than the margin.
constexpr int a_end = 1;
constexpr int b_end = 2;

// A direction: the two axes that it lies between, the share of the second in the cost; southwards and eastwards in a
// length of 1.
struct Heading {
    Index first = 0, second = 0;
    double share = 0.0, down = 0.0, right = 0.0;
};

struct Point {
    double r, c;
};

struct Costs {
    Array<const float, 3> tiles, gradient;
    double climb, descent, side, steepest;

    // The share of a gradient southwards and eastwards in the cost, in a direction of length 1; infinite if it is
    // barred.
    double of_slope(double south, double east, double down, double right) const {
        const double rise = south * down + east * right, across = std::abs(south * right - east * down);
        if (across > steepest) return infinite;
        return (rise > 0.0 ? climb * rise : -descent * rise) + side * across;
    }

    Heading heading(double dr, double dc, double length) const {
        constexpr double tangent = 0.41421356237309515;  // of 22.5 degrees: TAN in core/route_types.py
        const double south = length > 0.0 ? dr / length : 0.0, east = length > 0.0 ? dc / length : 0.0;
        if (tiles.shape[2] == 1) return {0, 0, 0.0, south, east};
        const double down = std::abs(dr), right = std::abs(dc), more = std::max(down, right);
        const bool north_east = dr * dc < 0.0;
        const double t = more > 0.0 ? std::min(down, right) / more : 0.0;
        const Index straight = down >= right ? 0 : 4, diagonal = north_east ? 2 : 6;
        const Index between = down >= right ? (north_east ? 1 : 7) : (north_east ? 3 : 5);
        if (t <= tangent) return {straight, between, t / tangent, south, east};
        return {between, diagonal, (t - tangent) / (1.0 - tangent), south, east};
    }

    bool inside(Index row, Index col) const {
        return row >= 0 && col >= 0 && row < tiles.shape[0] && col < tiles.shape[1];
    }

    bool open(Index row, Index col) const { return inside(row, col) && tiles(row, col, 0) < infinite; }

    // The cost of a tile in a direction; infinite outside the window.
    double of(const Heading& heading, Index row, Index col) const {
        if (!inside(row, col)) return infinite;
        double total = tiles(row, col, heading.first);
        if (heading.share != 0.0 && total < infinite)
            total += heading.share * (tiles(row, col, heading.second) - total);
        if (gradient.shape[0] > 0)
            total += of_slope(gradient(row, col, 0), gradient(row, col, 1), heading.down, heading.right);
        return total;
    }

    // Rows and columns back to the tile that counts where a line runs on the border of two: the dearer one. `r` is the
    // row of a line that keeps it, NaN otherwise; `c` likewise.
    std::array<Index, 2> dearer_shift(const Heading& heading, Point along, Index row, Index col) const {
        const double here = of(heading, row, col);
        if (along.r == static_cast<double>(row) && of(heading, row - 1, col) > here) return {1, 0};
        if (along.c == static_cast<double>(col) && of(heading, row, col - 1) > here) return {0, 1};
        return {0, 0};
    }
};

// The row or column that a line keeps, NaN where it does not.
inline Point kept_by(Point a, double dr, double dc) {
    constexpr double none = std::numeric_limits<double>::quiet_NaN();
    return {dr == 0.0 ? a.r : none, dc == 0.0 ? a.c : none};
}

// The exact integral of the cost along a segment; infinite as soon as it passes `limit`. Where the segment runs along a
// border, the dearer of both tiles counts.
inline double segment_cost(const Costs& cost, Point a, Point b, double limit) {
    const double dr = b.r - a.r, dc = b.c - a.c, length = std::sqrt(dr * dr + dc * dc);
    const Heading heading = cost.heading(dr, dc, length);
    double north = std::floor(a.r), west = std::floor(a.c);
    if (dr < 0.0 && north == a.r) north -= 1.0;
    if (dc < 0.0 && west == a.c) west -= 1.0;
    Index row = static_cast<Index>(north), col = static_cast<Index>(west);
    const bool keeps = dr == 0.0 || dc == 0.0;
    if (north <= b.r && b.r <= north + 1.0 && west <= b.c && b.c <= west + 1.0 && !keeps) {  // all in one tile
        const double total = length > sliver ? length * cost.of(heading, row, col) : 0.0;
        return total <= limit ? total : infinite;
    }
    const Index down = dr > 0.0 ? 1 : -1, right = dc > 0.0 ? 1 : -1;
    double r_edge = north + (dr > 0.0), c_edge = west + (dc > 0.0);
    double next_r = dr != 0.0 ? (r_edge - a.r) / dr : 2.0, next_c = dc != 0.0 ? (c_edge - a.c) / dc : 2.0;
    double total = 0.0, t = 0.0;
    while (true) {
        const double end = std::min({next_r, next_c, 1.0}), piece = (end - t) * length;
        if (piece > sliver) {
            const std::array<Index, 2> back =
                keeps ? cost.dearer_shift(heading, kept_by(a, dr, dc), row, col) : std::array<Index, 2>{};
            total += piece * cost.of(heading, row - back[0], col - back[1]);
            if (!(total <= limit)) return infinite;
        }
        if (end >= 1.0) return total;
        if (next_r <= end) {
            row += down;
            r_edge += static_cast<double>(down);
            next_r = (r_edge - a.r) / dr;
        }
        if (next_c <= end) {
            col += right;
            c_edge += static_cast<double>(right);
            next_c = (c_edge - a.c) / dc;
        }
        t = std::max(t, end);
    }
}

// The distance of a point to a tile; 0 in it.
inline double to_tile(Point a, Index row, Index col) {
    const double north = static_cast<double>(row), west = static_cast<double>(col);
    const double dr = std::max({north - a.r, a.r - north - 1.0, 0.0});
    const double dc = std::max({west - a.c, a.c - west - 1.0, 0.0});
    return std::sqrt(dr * dr + dc * dc);
}

// Narrows the shares [first, last] of a segment to those between two borders of an axis; false where none is.
inline bool clip(double a, double delta, double low, double& first, double& last) {
    if (delta == 0.0) return a >= low && a <= low + 1.0;
    const double t0 = (low - a) / delta, t1 = (low + 1.0 - a) / delta;
    first = std::max(first, std::min(t0, t1));
    last = std::min(last, std::max(t0, t1));
    return true;
}

// The distance of a segment to a tile: that of an end to the tile, or of a corner of the tile to the segment.
inline double gap(Point a, Point b, Index row, Index col) {
    const double north = static_cast<double>(row), west = static_cast<double>(col);
    const double dr = b.r - a.r, dc = b.c - a.c;
    double first = 0.0, last = 1.0;
    if (clip(a.r, dr, north, first, last) && clip(a.c, dc, west, first, last) && first <= last) return 0.0;
    const double square = dr * dr + dc * dc;
    double least = std::min(to_tile(a, row, col), to_tile(b, row, col));
    if (square == 0.0) return least;
    for (const auto& corner :
         {Point{north, west}, {north, west + 1.0}, {north + 1.0, west}, {north + 1.0, west + 1.0}}) {
        double r = corner.r - a.r, c = corner.c - a.c;
        const double t = std::min(std::max((r * dr + c * dc) / square, 0.0), 1.0);
        r -= t * dr;
        c -= t * dc;
        least = std::min(least, std::sqrt(r * r + c * c));
    }
    return least;
}

// True if a distance is nearer than a margin allows.
inline bool too_near(double distance, double margin) { return distance < margin - std::min(rounding, 0.5 * margin); }

// True if a segment keeps a margin from all closed tiles. From a tile that an end in `ends` is nearer to, it need not
// keep more than that end does.
inline bool segment_clear(const Costs& cost, Point a, Point b, double margin, int ends) {
    const double dr = b.r - a.r, dc = b.c - a.c;
    const auto tile = [](double place) { return static_cast<Index>(std::floor(place)); };
    const Index south = tile(std::max(a.r, b.r) + margin);
    for (Index row = tile(std::min(a.r, b.r) - margin); row <= south; ++row) {
        double first = 0.0, last = 1.0;
        if (dr != 0.0) {
            const double r = static_cast<double>(row);
            const double t0 = (r - margin - a.r) / dr, t1 = (r + 1.0 + margin - a.r) / dr;
            first = std::max(0.0, std::min(t0, t1));
            last = std::min(1.0, std::max(t0, t1));
        }
        const double c0 = a.c + first * dc, c1 = a.c + last * dc;
        const Index east = tile(std::max(c0, c1) + margin);
        for (Index col = tile(std::min(c0, c1) - margin); col <= east; ++col) {
            if (cost.open(row, col)) continue;
            double need = margin;
            if (ends & a_end) need = std::min(need, to_tile(a, row, col));
            if (ends & b_end) need = std::min(need, to_tile(b, row, col));
            if (too_near(gap(a, b, row, col), need)) return false;
        }
    }
    return true;
}

inline Point point_at(Array<const double, 2> points, Index i) { return {points(i, 0), points(i, 1)}; }

}  // namespace bumpy

BUMPY_RECORD(bumpy::Costs, tiles, gradient, climb, descent, side, steepest)
