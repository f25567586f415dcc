// Shared by the loops that find the ground of a scan: the cells, their planes and their parts. Records as in
// ground.py.
#pragma once

#include <algorithm>
#include <limits>

#include "polar.hpp"

namespace bumpy {

// Parts of a cell along each side: outwards and around; PARTS in ground.py.
constexpr Index parts = 5;
constexpr Index parts_of_cell = parts * parts;
// Kinds of planes: passed on by a neighbour; fitted to the cell's own points; passed on before the second round, for
// where nothing better is known. 0: none.
constexpr std::int32_t carried = 1, found = 2, guessed = 3;
constexpr double infinite = std::numeric_limits<double>::infinity();

struct CellGeometry {
    Array<const double> x, y;
    Array<const std::int32_t, 2> near;
    Array<const std::int32_t> zone, ring, sector, first, rings, sectors;

    Index cells() const { return x.size(); }
};

struct Place {
    double x, y;
};

// A plane by its slope along x and y, and its height at the origin, m.
struct Slope {
    double a, b, c;

    double height(double x, double y) const { return a * x + b * y + c; }
};

struct GroundPlanes {
    Array<double, 2> plane, centre;
    Array<double> spread;
    Array<std::int32_t> kind;

    Slope at(Index cell) const { return {plane(cell, 0), plane(cell, 1), plane(cell, 2)}; }

    void put(Index cell, Slope of, Place middle, double away) const {
        std::copy_n(&of.a, 3, &plane(cell, 0));
        centre(cell, 0) = middle.x;
        centre(cell, 1) = middle.y;
        centre(cell, 2) = away;
    }
};

}  // namespace bumpy

BUMPY_RECORD(bumpy::CellGeometry, x, y, near, zone, ring, sector, first, rings, sectors)
BUMPY_RECORD(bumpy::GroundPlanes, plane, centre, spread, kind)
