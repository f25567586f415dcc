// Shared by the loops over a scan: the polar grid, the points by cell, sums in any order, the angle of a direction. The
// records are explained in ground.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <vector>

#include "bumpytiles/bindings.hpp"

namespace bumpy {

constexpr double infinite = std::numeric_limits<double>::infinity();

// Memory of a loop, indexed as an `Array` is.
template <class T>
struct Scratch : std::vector<T> {
    explicit Scratch(Index size = 0, T value = {}) : std::vector<T>(static_cast<std::size_t>(size), value) {}

    Index count() const { return static_cast<Index>(this->size()); }
    T& operator[](Index i) { return std::vector<T>::operator[](static_cast<std::size_t>(i)); }
    const T& operator[](Index i) const { return std::vector<T>::operator[](static_cast<std::size_t>(i)); }
};

// Fills memory that is kept from scan to scan, so that the system need not give it anew.
template <class T>
void renew(Scratch<T>& kept, Index size, T value = {}) {
    kept.assign(static_cast<std::size_t>(size), value);
}

struct ZoneGrid {
    Array<const double> edges;
    Array<const Index> sectors, rings;
    double start;
    Index pixels;
};

struct CellPoints {
    Array<Index> starts;
    Array<std::int32_t> order;
    Array<float, 2> xyz;
    Array<std::int32_t> pixel, bin;
};

// The place in bins (surface.hpp) of a point outside of the grid.
constexpr std::uint16_t no_place = 65535;

// A number rounded to a multiple of 2^-28: sums of such terms are exact below 2^25, so that the order of the points of
// a scan does not matter. For numbers up to 2^23.
inline double exact(double term) {
    constexpr double rounding = 3.0 * (1 << 23);  // its last bit is 2^-28
    return (term + rounding) - rounding;
}

// Angle from the x axis towards y as a share of a full turn, -0.5 to 0.5; 0 at the origin. The arctangent's own series,
// after the angle was folded into an eighth of a half turn: as exact as is needed, without a call to a library whose
// last bit differs between machines, and without a branch that could not be foreseen.
inline double turn_of(double x, double y) {
    constexpr double eighth = std::numbers::sqrt2 - 1.0;  // tangent of an eighth of a half turn
    const double ax = std::abs(x), ay = std::abs(y);
    const bool is_steep = ay > ax;
    const double high = is_steep ? ay : ax, low = is_steep ? ax : ay;
    const bool is_folded = low > eighth * high;
    const double above = is_folded ? low - high : low, below = is_folded ? low + high : high;
    const double t = above / (below > 0.0 ? below : 1.0);
    const double q = t * t;
    double s = 1.0 / 19 - q * (1.0 / 21);
    s = 1.0 / 11 - q * (1.0 / 13 - q * (1.0 / 15 - q * (1.0 / 17 - q * s)));
    s = 1.0 / 3 - q * (1.0 / 5 - q * (1.0 / 7 - q * (1.0 / 9 - q * s)));
    double angle = t * (1.0 - q * s) * (0.5 / std::numbers::pi) + (is_folded ? 0.125 : 0.0);
    angle = is_steep ? 0.25 - angle : angle;
    angle = x < 0.0 ? 0.5 - angle : angle;
    return y < 0.0 ? -angle : angle;
}

// The same from 0 up to, but not, 1.
inline double full_turn(double turn) {
    turn = turn < 0.0 ? turn + 1.0 : turn;
    return turn < 1.0 ? turn : 0.0;
}

}  // namespace bumpy

BUMPY_RECORD(bumpy::ZoneGrid, edges, sectors, rings, start, pixels)
BUMPY_RECORD(bumpy::CellPoints, starts, order, xyz, pixel, bin)
