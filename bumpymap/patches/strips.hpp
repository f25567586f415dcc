// True if pulses get through what is overhead, by its points and those beneath them.
//
// A wall that is seen from above has its points in a strip without ground; a bar, a wire or a branch has ground in it.
// So the points around a pixel are put in order across the strip that those overhead lie along, and the part of it is
// found where they outnumber the ground most. That holds as many points as it takes at any density: in a thin survey it
// is looked for in more pixels. Ours.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <vector>

#include "bumpytiles/arrays.hpp"

namespace bumpy {

// Points overhead that one beneath outweighs: where pulses are hidden, fewer than one in four gets through.
constexpr int beneath_weight = 3;
// Where half of the pulses get through, points overhead outweigh those of the ground by m somewhere among n with a
// chance of about n exp(-m chance): the log of the root of x^3 = x^2 + x + 1, for steps of +1 and -3 in turn.
constexpr double chance = 0.609;
// Width of the bins across a strip, m, and their number.
constexpr double bin_width = 0.025;
constexpr int bins = 100;
// Bins of what hides the ground, at least: what is narrower than 0.1 m is a wire.
constexpr int narrowest = 4;
// Side of the square that is looked at: a strip as narrow as that and as long has this number of points on average; m,
// at least.
constexpr double strip_points = 12.0, least_side = 1.0;
// Pixels beyond the middle that half a square holds, so that a pixel beside a wall's end is not taken for the wall.
constexpr Index overlap = 2;

// Pixels on either side of one that are looked at, by points per m2 and the side of a pixel, m.
inline Index strip_half(double density, double pixel) {
    const double side = std::max(least_side, strip_points / (narrowest * bin_width * density));
    return static_cast<Index>(std::ceil(0.5 * (side / pixel - 1.0) - 1e-9));
}

// True if points overhead outweigh those beneath by so much, and more where there are many.
inline bool outweighs(Index over, Index beneath, double least) {
    return static_cast<double>(over - beneath_weight * beneath) >= least + std::log(static_cast<double>(over)) / chance;
}

// By how much points overhead must outweigh those beneath: by a number, and more where there are many points; or, if
// there is a share, by that share of them and no less than the number.
struct Weight {
    double number, share = 0.0;
};

// Columns and rows of points from the north-west corner of a tile, px, row by row of its pixels; in a pixel the last
// that was added comes first.
class PointsByPixel {
  public:
    std::vector<double> x, y;

    void clear() { added.clear(); }
    void add(Index pixel, double col, double row) { added.push_back({pixel, col, row}); }

    // Puts the points in order, when all are there.
    void sort(Index pixels) {
        begin.assign(pixels + 1, 0);
        for (const Point& point : added) ++begin[point.pixel];
        std::partial_sum(begin.begin(), begin.end(), begin.begin());
        x.resize(added.size());
        y.resize(added.size());
        for (const Point& point : added) {
            const Index place = --begin[point.pixel];
            x[place] = point.x;
            y[place] = point.y;
        }
    }

    // Where those of a pixel begin, and those of the pixels before it end.
    Index first_of(Index pixel) const { return begin[pixel]; }

  private:
    struct Point {
        Index pixel;
        double x, y;
    };

    std::vector<Point> added;
    std::vector<Index> begin;
};

// Points of a tile over the ground and on it, and whether they hide it.
class Strips {
  public:
    explicit Strips(Index pixels) : size(pixels) {}

    PointsByPixel over, beneath;

    // True if what is overhead in a pixel hides the ground: it outweighs what is beneath in a part of the strip around
    // its points, in a square of 2 half + 1 pixels around it. One half of the square will do, or a smaller one of what
    // is low: at a corner walls meet.
    bool hides_ground(Index r, Index c, Index half, Weight least, bool is_low, double pixel) const {
        const Index near = std::max(half / 2, overlap);
        // All of the square, its halves, and one of half its side: pixels to the north, south, west and east.
        const std::array<std::array<Index, 4>, 6> reaches{{
            {half, half, half, half},
            {overlap, half, half, half},
            {half, overlap, half, half},
            {half, half, overlap, half},
            {half, half, half, overlap},
            {near, near, near, near},
        }};
        const std::size_t parts = half <= overlap ? 1 : is_low ? 6 : 5;
        return std::any_of(reaches.begin(), reaches.begin() + parts, [&](const auto& reach) {
            const Window window{
                std::max<Index>(0, r - reach[0]), std::min(size, r + reach[1] + 1), std::max<Index>(0, c - reach[2]),
                std::min(size, c + reach[3] + 1)};
            return strip_weighs(r, c, window, least, pixel);
        });
    }

  private:
    // Rows and columns of pixels, the last ones not included.
    struct Window {
        Index top, bottom, left, right;
    };

    // Calls function(x, y) for the points in a window.
    template <class Function>
    void for_each(const PointsByPixel& points, const Window& window, Function function) const {
        for (Index row = window.top; row < window.bottom; ++row) {
            const Index last = points.first_of(row * size + window.right);
            for (Index i = points.first_of(row * size + window.left); i < last; ++i) function(points.x[i], points.y[i]);
        }
    }

    Index count_over(const Window& window) const {
        Index count = 0;
        for (Index row = window.top; row < window.bottom; ++row)
            count += over.first_of(row * size + window.right) - over.first_of(row * size + window.left);
        return count;
    }

    // True if points overhead outweigh those beneath in the strip of a window around those of a pixel.
    bool strip_weighs(Index r, Index c, const Window& window, Weight least, double pixel) const {
        const Window middle_pixel{r, r + 1, c, c + 1};
        const auto n = static_cast<double>(count_over(window)), own = static_cast<double>(count_over(middle_pixel));
        if (n < least.number || own == 0.0) return false;
        const double x0 = static_cast<double>(c) + 0.5, y0 = static_cast<double>(r) + 0.5;
        double own_x = 0.0, own_y = 0.0, sx = 0.0, sy = 0.0, xx = 0.0, xy = 0.0, yy = 0.0;
        for_each(over, middle_pixel, [&](double x, double y) {
            own_x += x - x0;
            own_y += y - y0;
        });
        for_each(over, window, [&](double col, double row) {
            const double x = col - x0, y = row - y0;
            sx += x;
            sy += y;
            xx += x * x;
            xy += x * y;
            yy += y * y;
        });
        // Across the strip is the direction in which the points vary least.
        xx -= sx * sx / n;
        xy -= sx * sy / n;
        yy -= sy * sy / n;
        const double spread = 0.5 * (xx + yy) - std::sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy);
        double a = xx < yy ? spread - yy : xy, b = xx < yy ? xy : spread - xx;
        const double length = std::sqrt(a * a + b * b);
        const double scale = length > 0.0 ? pixel / bin_width / length : 0.0;
        a *= scale;
        b *= scale;
        const double middle = 0.5 * bins - a * (x0 + own_x / own) - b * (y0 + own_y / own);
        std::array<int, bins + 1> weights{};  // of each bin, behind a zero
        const auto add = [&](double x, double y, int weight) {
            const double across = middle + a * x + b * y;
            if (0.0 <= across && across < bins) weights[static_cast<std::size_t>(across) + 1] += weight;
        };
        for_each(over, window, [&](double x, double y) { add(x, y, 1); });
        for_each(beneath, window, [&](double x, double y) { add(x, y, -beneath_weight); });
        return holds_part(
            least.share > 0.0 ? std::max(least.number, least.share * n) : least.number + std::log(n) / chance, weights);
    }

    // True if a part of a strip around or beside its middle weighs so much.
    static bool holds_part(double least, std::array<int, bins + 1>& sums) {
        for (std::size_t k = 0; k < bins; ++k) sums[k + 1] += sums[k];
        int lowest = sums[0];
        for (std::size_t k = narrowest; k <= bins; ++k) {
            if (k - narrowest <= bins / 2 + 1) lowest = std::min(lowest, sums[k - narrowest]);
            if (k >= bins / 2 && sums[k] - lowest >= least) return true;
        }
        return false;
    }

    const Index size;
};

}  // namespace bumpy
