// The ground of a scan as a smooth surface over small bins around the sensor, see surface.cpp.
#pragma once

#include <array>
#include <bit>

#include "polar.hpp"

namespace bumpy {

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
        count = of(square(end)) + 1;
    }

    static double square(double x) { return x * x; }
    static std::int32_t bits(double r2) { return std::bit_cast<std::int32_t>(static_cast<float>(r2)); }

    std::int32_t of(double r2) const { return std::max((bits(r2) >> shift) - first, 0); }

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

// Calls `act` with each bin within `wide` of another one, in rings that exist; stops where it returns false.
template <class Act>
void around_bin(Index bin, Index wide, Index rings, Act act) {
    const Index ring = bin / bin_columns, column = bin % bin_columns;
    for (Index r = std::max(ring - wide, Index{0}); r <= std::min(ring + wide, rings - 1); ++r)
        for (Index c = column - wide; c <= column + wide; ++c)
            if ((r != ring || c != column) && !act(r * bin_columns + ((c + bin_columns) % bin_columns))) return;
}

// Classes of the ground in the bins of a frame (places.py).
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

// A plane by its slope along x and y, and its height at the origin, m.
struct Tilt {
    double a = 0.0, b = 0.0, c = 0.0;

    double height(double x, double y) const { return a * x + b * y + c; }
    double above(double x, double y, double z) const { return z - height(x, y); }
};

// The layers of the bins that have one, inwards first: their lowest points, which may be ground.
struct Layers {
    Scratch<double> x, y, z, r;     // mean of the points, distance, m
    Scratch<double> weight, share;  // by their number; of the points of the bin that are in it, or not far over it
    Scratch<std::int32_t> bin;

    Index size() const { return x.count(); }

    // The middle of a layer's bin, in bins outwards and around.
    std::array<double, 2> middle(Index i) const {
        return {static_cast<double>(bin[i] / bin_columns) + 0.5, static_cast<double>(bin[i] % bin_columns) + 0.5};
    }
};

// Unit vectors in equal steps of a turn, without a call to a library whose last bit differs between machines.
template <std::size_t Count>
std::array<std::array<double, 2>, Count> directions() {
    std::array<std::array<double, 2>, Count> out{};
    const std::size_t quarter = Count / 4;
    out[0] = {1.0, 0.0};
    out[quarter] = {0.0, 1.0};
    for (std::size_t step = quarter; step > 1; step /= 2) {
        for (std::size_t k = 0; k < quarter; k += step) {
            const auto [ax, ay] = out[k];
            const auto [bx, by] = out[k + step];
            const double length = std::sqrt((ax + bx) * (ax + bx) + (ay + by) * (ay + by));
            out[k + step / 2] = {(ax + bx) / length, (ay + by) / length};
        }
    }
    for (std::size_t k = quarter; k < Count; ++k) out[k] = {-out[k - quarter][1], out[k - quarter][0]};
    return out;
}

// The four windows around a place, their weights there, and how these grow with bins outwards and around.
struct Windows {
    std::array<Index, 4> number;
    std::array<double, 4> weight, outwards, across;
};

// A level of the surface: a plane for each of its overlapping windows.
class Level {
  public:
    Level(Index step, const BinRings& rings)
        : step_(step), columns_(bin_columns / step), rows_((rings.count + step - 1) / step + 2) {}

    Index size() const { return rows_ * columns_; }
    Index step() const { return step_; }

    // The windows around a place in bins outwards and around.
    Windows around(double ring, double column) const {
        const double size = static_cast<double>(step_);
        const double out = std::clamp(ring / size + 0.5, 0.0, static_cast<double>(rows_ - 1));
        const double turn = column / size - 0.5 + static_cast<double>(columns_);
        const Index row = std::min(static_cast<Index>(out), rows_ - 2), left = static_cast<Index>(turn);
        const double far = out - static_cast<double>(row), right = turn - static_cast<double>(left);
        const Index begin = row * columns_, a = left % columns_, b = (left + 1) % columns_;
        const double near = 1.0 - far, left_of = 1.0 - right;
        return {
            {begin + a, begin + b, begin + columns_ + a, begin + columns_ + b},
            {near * left_of, near * right, far * left_of, far * right},
            {-left_of / size, -right / size, left_of / size, right / size},
            {-near / size, near / size, -far / size, far / size}};
    }

    // The middle of a window in bins outwards and around.
    std::array<double, 2> middle(Index window) const {
        const double size = static_cast<double>(step_);
        const auto row = static_cast<double>(window / columns_), column = static_cast<double>(window % columns_);
        return {(row - 0.5) * size, (column + 0.5) * size};
    }

    // The same in m.
    std::array<double, 2> centre(Index window, const BinRings& rings) const {
        static const auto turns = directions<2 * bin_columns>();
        const auto [ring, column] = middle(window);
        const auto [x, y] = turns[static_cast<std::size_t>(2.0 * column)];
        const double r = rings.distance(ring);
        return {r * x, r * y};
    }

    Tilt blend(const Windows& at) const {
        Tilt out;
        for (std::size_t k = 0; k < 4; ++k) {
            const Tilt& plane = planes[at.number[k]];
            out.a += at.weight[k] * plane.a;
            out.b += at.weight[k] * plane.b;
            out.c += at.weight[k] * plane.c;
        }
        return out;
    }

    // The plane that touches the surface at a place, m, in bins outwards and around.
    Tilt touch(double x, double y, double ring, double column) const {
        const Windows at = around(ring, column);
        Tilt out = blend(at);
        const double square = x * x + y * y, height = out.height(x, y);
        double outwards = 0.0, across = 0.0;
        for (std::size_t k = 0; k < 4; ++k) {
            const double own = planes[at.number[k]].height(x, y);
            outwards += at.outwards[k] * own;
            across += at.across[k] * own;
        }
        outwards *= octave_rings / (std::numbers::ln2 * std::max(square, 1e-6));
        across *= bin_columns / (2.0 * std::numbers::pi * std::max(square, 1e-6));
        out.a += outwards * x - across * y;
        out.b += outwards * y + across * x;
        out.c = height - out.a * x - out.b * y;
        return out;
    }

    Scratch<Tilt> planes;

  private:
    Index step_, columns_, rows_;
};

// The ground of a scan.
struct Surface {
    Layers layers;
    Tilt whole;                 // the plane that most of it lies on, and the objects above
    std::vector<Level> levels;  // the widest windows first; the last is the surface, the first shows how it slopes
};

Surface find_surface(const CellPoints& points, const BinRings& rings);

}  // namespace bumpy

BUMPY_RECORD(bumpy::ClassField, says, least, unknown)
