// The points of a scan on the polar grid, and their ground as a smooth surface over small bins, see surface.cpp.
#pragma once

#include "polar.hpp"

namespace bumpy {

// A point of the scan, m, and its place: `row * pixels + column` in its cell, and the small bin that it lies in.
struct ScanPoint {
    float x, y, z;
    std::int32_t number;  // in the scan
};
struct PointPlace {
    std::uint16_t pixel, bin;
};

// Points on the polar grid, side by side by cell.
struct PlacedPoints {
    Scratch<ScanPoint> point;
    Scratch<PointPlace> place;
    Scratch<float> lowest;  // (bins,) z of the lowest point in each, m

    Index count() const { return point.count(); }
};

// A plane by its slope along x and y, and its height at the origin, m.
struct Tilt {
    double a = 0.0, b = 0.0, c = 0.0;

    double above(double x, double y, double z) const { return z - (a * x + b * y + c); }
};

// Weighted sums of fits of heights over a place; exact, in any order.
template <class T>
struct FitSums {
    std::array<T, 9> of = {};

    void add(const T& weight, const T& x, const T& y, const T& height) {
        const T wx = weight * x, wy = weight * y;
        const std::array<T, 9> terms{weight, wx, wy, wx * x, wx * y, wy * y, weight * height, wx * height, wy * height};
        for (std::size_t i = 0; i < terms.size(); ++i) add_exact(of[i], terms[i]);
    }
    // Adds the sums of one of four places.
    void add(const FitSums<Four>& four, std::size_t place) {
        for (std::size_t i = 0; i < of.size(); ++i) of[i] += four.of[i][place];
    }
};

// The plane of least squares, pulled to zero with the weight of some points there and a metre from it.
inline Tilt fit_plane(const FitSums<double>& sums, double at, double slope) {
    const auto [n, x, y, xx, xy, yy, h, xh, yh] = sums.of;
    const double nn = n + at, uu = xx + slope, vv = yy + slope;
    const double xu = uu - x * x / nn, xv = xy - x * y / nn, yv = vv - y * y / nn;
    const double hu = xh - x * h / nn, hv = yh - y * h / nn;
    const double det = xu * yv - xv * xv;
    const double a = (hu * yv - hv * xv) / det, b = (hv * xu - hu * xv) / det;
    return {a, b, (h - a * x - b * y) / nn};
}

// The four windows around a place, and their weights there.
struct Windows {
    std::array<Index, 4> number;
    Four weight;
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
        const double shrink = 1.0 / static_cast<double>(step_);  // exact: steps are powers of two
        const double out = std::clamp(ring * shrink + 0.5, 0.0, static_cast<double>(rows_ - 1));
        const double turn = column * shrink - 0.5 + static_cast<double>(columns_);
        const Index row = std::min(static_cast<Index>(out), rows_ - 2), left = static_cast<Index>(turn);
        const double far = out - static_cast<double>(row), right = turn - static_cast<double>(left);
        const Index begin = row * columns_, a = left & (columns_ - 1), b = (left + 1) & (columns_ - 1);
        const double near = 1.0 - far, left_of = 1.0 - right;
        return {
            {begin + a, begin + b, begin + columns_ + a, begin + columns_ + b},
            Four{near * left_of, near * right, far * left_of, far * right}};
    }

    // The middle of a window in bins outwards and around.
    std::array<double, 2> middle(Index window) const {
        const double size = static_cast<double>(step_);
        const auto row = static_cast<double>(window / columns_), column = static_cast<double>(window % columns_);
        return {(row - 0.5) * size, (column + 0.5) * size};
    }

    // The plane around a place in bins outwards and around.
    Tilt at(double ring, double column) const {
        const Windows windows = around(ring, column);
        Tilt out;
        for (std::size_t k = 0; k < 4; ++k) {
            const Tilt& plane = planes[windows.number[k]];
            out.a += windows.weight[k] * plane.a;
            out.b += windows.weight[k] * plane.b;
            out.c += windows.weight[k] * plane.c;
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
    Tilt whole;  // the plane that most of it lies on, and the objects above
    Level wide;  // the surface in its widest windows: how it slopes
    bool hangs;  // whether the frame hangs from what looks like ground
};

// A point is ground from here over the surface up to the reach of its bin, m.
constexpr float below_surface = -0.5F;

// Finds the ground, the heights of all points over it, m, and up to which height those of each bin are ground, m; no
// higher than `below_surface` where none are.
Surface find_surface(
    const PlacedPoints& points, const BinRings& rings, Scratch<float>& heights, Scratch<float>& reaches);

// Measures of a bin, and the number of ground points about it.
constexpr std::size_t place_measures = 7;

// Writes the measures of every bin, smoothed over those around it; `belly`, `height`: of the vehicle, m.
void measure_places(
    const PlacedPoints& points, const Scratch<float>& heights, const Scratch<float>& reaches, float belly, float height,
    Array<float, 2> out);

}  // namespace bumpy
