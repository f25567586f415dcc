// Tiles, pixels and coordinates along one axis, as `bumpytiles.Grid` and `bumpytiles.Scaling` define them.
#pragma once

#include <algorithm>
#include <cmath>

#include "arrays.hpp"

namespace bumpy {

// Tiles along a side of a block: one unit of work.
constexpr Index block_tiles = 16;
// Steps a metre in which tile and pixel are found: finer than the grids of files, but coarser than the rounding of
// decimal numbers, feet and borders to double, which is 3e-9 m at 10,000 km.
constexpr double steps_per_metre = 1e8;
// A coordinate that lies so far below a border, m, or less, is on it.
constexpr double below_border = -0.5 / steps_per_metre;

inline Index floor_divide(Index a, Index b) { return a / b - (a % b != 0 && (a % b < 0) != (b < 0)); }

inline Index modulo(Index a, Index b) { return a - floor_divide(a, b) * b; }

// The tile index along one axis; the twin of `Grid.index`.
inline Index tile_index(double coordinate, double size) {
    const double i = std::floor(coordinate / size);
    if (coordinate - i * size < below_border) return static_cast<Index>(i) - 1;
    if (coordinate - (i + 1.0) * size >= below_border) return static_cast<Index>(i) + 1;
    return static_cast<Index>(i);
}

// How many pixels a coordinate lies from the border `first` of its tile; the whole ones are the index. By whole steps:
// on the border of two pixels there is no rounding.
inline double pixels_from(double first, double coordinate, double size, double pixels) {
    return pixels * std::rint((coordinate - first) * steps_per_metre) / std::rint(size * steps_per_metre);
}

// How integers of a file's own grid become metres: scales, offsets and metres of the unit of x, y and z; none where
// coordinates are in metres.
struct Scaling {
    Array<const double> numbers;

    double metres(double metres, Index) const { return metres; }
    double metres(std::int32_t number, Index axis) const {
        constexpr double round = 1e8;  // coordinates have 8 decimals, in the file's unit; DECIMALS in grouping.py
        return std::rint((number * numbers[axis] + numbers[3 + axis]) * round) / round * numbers[6 + axis];
    }
};

}  // namespace bumpy
