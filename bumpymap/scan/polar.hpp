// Shared by the loops over a scan: sums in any order, the angle of a direction, the small bins around the sensor.
// Records are explained in sectors.py.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <numbers>
#include <vector>

#include "bumpytiles/bindings.hpp"

namespace bumpy {

constexpr double infinite = std::numeric_limits<double>::infinity();

// Memory of a loop, indexed as an `Array` is.
template <class T>
struct Scratch : std::vector<T> {
    explicit Scratch(Index size = 0, const T& value = T{}) : std::vector<T>(static_cast<std::size_t>(size), value) {}

    Index count() const { return static_cast<Index>(this->size()); }
    T& operator[](Index i) { return std::vector<T>::operator[](static_cast<std::size_t>(i)); }
    const T& operator[](Index i) const { return std::vector<T>::operator[](static_cast<std::size_t>(i)); }
};

// Memory that each thread keeps from scan to scan. By a pointer: else compilers ask for its address again and again.
template <class T>
T& kept_memory() {
    thread_local const auto memory = std::make_unique<T>();
    return *memory;
}

// Fills memory that is kept from scan to scan, so that the system need not give it anew.
template <class T>
void renew(Scratch<T>& kept, Index size, const T& value = T{}) {
    kept.assign(static_cast<std::size_t>(size), value);
}

struct ZoneGrid {
    Array<const double> edges;
    Array<const Index> sectors, rings;
    double start;
};

// The place in bins of a point outside of the grid.
constexpr std::uint16_t no_place = 65535;

// A number rounded to a multiple of 2^-28: sums of such terms are exact below 2^25, so that the order of the points of
// a scan does not matter. For numbers up to 2^23.
constexpr double rounding = 3.0 * (1 << 23);  // its last bit is 2^-28
inline double exact(double term) { return (term + rounding) - rounding; }

// Four numbers of which a processor computes all at once: sectors take 673 instructions a point of a frame of 64 beams
// where they took 743, by valgrind. Passed by reference alone: how it is passed by value differs between builds.
using Four [[gnu::vector_size(32)]] = double;

// Adds a term, or four, so rounded.
template <class T>
void add_exact(T& sum, const T& term) {
    sum += (term + rounding) - rounding;
}
inline double sum_of(const Four& terms) { return ((terms[0] + terms[1]) + terms[2]) + terms[3]; }

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

// Columns of bins around the sensor, and rings of bins while the distance doubles: bins are as long as they are wide.
constexpr Index bin_columns = 128, octave_rings = 16;
// Places in bins are counted in parts of one.
constexpr std::int32_t bin_parts = 256;

// The rings of bins, which grow outwards: by the leading bits of the squared distance as a float, which are nearly its
// logarithm.
struct BinRings {
    static constexpr double nearest = 0.25;  // nearer points are in the first ring, m
    static constexpr int shift = 20;         // leaves the exponent and three bits of the fraction

    std::int32_t first;
    Index count;

    explicit BinRings(const ZoneGrid& grid) : first(bits(square(std::max(grid.edges[0], nearest))) >> shift) {
        const double end = std::max(grid.edges[grid.sectors.size()], nearest);
        count = parts(square(end)) / bin_parts + 1;
    }

    static double square(double x) { return x * x; }
    static std::int32_t bits(double r2) { return std::bit_cast<std::int32_t>(static_cast<float>(r2)); }

    // The place between rings of a squared distance, as a number and in `bin_parts`; and the distance [m] of a place.
    double place(double r2) const { return (bits(r2) - (first << shift)) / static_cast<double>(1 << shift); }
    std::int32_t parts(double r2) const {
        return std::max(bits(r2) - (first << shift), 0) / ((1 << shift) / bin_parts);
    }
    double distance(double place) const {
        const auto whole = static_cast<std::int32_t>(std::max(place, 0.0) * (1 << shift)) + (first << shift);
        return std::sqrt(static_cast<double>(std::bit_cast<float>(whole)));
    }
};

// Classes of the ground in the bins of a frame (sectors.py).
struct ClassField {
    Array<const float, 2> says;  // (bins, classes + 1) a number for each class, and the ground points about the bin
    double least;                // of these points, where the ground is known
    std::uint8_t unknown;        // the class elsewhere

    // The class with the highest number at a place in parts of a bin, between the middles of bins.
    std::uint8_t at(std::int32_t outwards, std::int32_t around) const {
        constexpr std::size_t columns = 4;  // three classes, and the points
        const std::int32_t from = std::max(outwards - bin_parts / 2, 0);
        const auto turn = static_cast<std::int32_t>(around + bin_columns * bin_parts - bin_parts / 2);
        const Index ring = from / bin_parts, left = turn / bin_parts % bin_columns, right = (left + 1) % bin_columns;
        const float* near = &says(ring * bin_columns, 0);
        const float* far = &says(std::min((ring + 1) * bin_columns, says.shape[0] - bin_columns), 0);
        const auto out = static_cast<float>(from % bin_parts) * (1.0F / bin_parts);
        const auto across = static_cast<float>(turn % bin_parts) * (1.0F / bin_parts);
        std::array<float, columns> found;
        for (std::size_t k = 0; k < columns; ++k) {
            const auto a = left * Index{columns} + static_cast<Index>(k),
                       b = right * Index{columns} + static_cast<Index>(k);
            const float inner = near[a] + across * (near[b] - near[a]), outer = far[a] + across * (far[b] - far[a]);
            found[k] = inner + out * (outer - inner);
        }
        if (found[3] < least) return unknown;
        return static_cast<std::uint8_t>(std::max_element(found.begin(), found.begin() + 3) - found.begin());
    }
};

}  // namespace bumpy

BUMPY_RECORD(bumpy::ZoneGrid, edges, sectors, rings, start)
BUMPY_RECORD(bumpy::ClassField, says, least, unknown)
