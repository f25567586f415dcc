// The ground of a scan as a smooth surface over small bins around the sensor, see surface.cpp.
#pragma once

#include "polar.hpp"

namespace bumpy {

// A point on the polar grid.
struct PlacedPoint {
    float x, y, z;                    // m
    std::int32_t number, pixel, bin;  // in the scan; `row * pixels + column` in its cell; small bin that it lies in
};
using PlacedPoints = Scratch<PlacedPoint>;

// A plane by its slope along x and y, and its height at the origin, m.
struct Tilt {
    double a = 0.0, b = 0.0, c = 0.0;

    double height(double x, double y) const { return a * x + b * y + c; }
    double above(double x, double y, double z) const { return z - height(x, y); }
};

// Weighted sums of a fit of heights over a place; exact, in any order.
struct Sums {
    double n = 0.0, x = 0.0, y = 0.0, xx = 0.0, xy = 0.0, yy = 0.0, h = 0.0, xh = 0.0, yh = 0.0;

    void add(double weight, double u, double v, double height) {
        const double wu = weight * u, wv = weight * v;
        n += exact(weight);
        x += exact(wu);
        y += exact(wv);
        xx += exact(wu * u);
        xy += exact(wu * v);
        yy += exact(wv * v);
        h += exact(weight * height);
        xh += exact(wu * height);
        yh += exact(wv * height);
    }

    // The plane of least squares, pulled to zero with the weight of some points there and a metre from it.
    Tilt solve(double at, double slope) const {
        const double nn = n + at, uu = xx + slope, vv = yy + slope;
        const double xu = uu - x * x / nn, xv = xy - x * y / nn, yv = vv - y * y / nn;
        const double hu = xh - x * h / nn, hv = yh - y * h / nn;
        const double det = xu * yv - xv * xv;
        const double a = (hu * yv - hv * xv) / det, b = (hv * xu - hu * xv) / det;
        return {a, b, (h - a * x - b * y) / nn};
    }
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

// The four windows around a place, and their weights there.
struct Windows {
    std::array<Index, 4> number;
    std::array<double, 4> weight;
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
            {near * left_of, near * right, far * left_of, far * right}};
    }

    // The middle of a window in bins outwards and around.
    std::array<double, 2> middle(Index window) const {
        const double size = static_cast<double>(step_);
        const auto row = static_cast<double>(window / columns_), column = static_cast<double>(window % columns_);
        return {(row - 0.5) * size, (column + 0.5) * size};
    }

    // The same in m.
    std::array<double, 2> centre(Index window, const BinRings& rings) const {
        const auto [ring, column] = middle(window);
        const double r = rings.distance(ring), turn = column * (2.0 * std::numbers::pi / bin_columns);
        return {r * std::cos(turn), r * std::sin(turn)};
    }

    // The plane around a place in bins outwards and around.
    Tilt at(double ring, double column) const { return blend(around(ring, column)); }

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

    // The height of the nearest ground at the origin, m: the mean of its windows'.
    double height_at_origin() const {
        double sum = 0.0;
        for (Index k = columns_; k < 2 * columns_; ++k) sum += planes[k].c;
        return sum / static_cast<double>(columns_);
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

Surface find_surface(const PlacedPoints& points, const BinRings& rings);

}  // namespace bumpy
