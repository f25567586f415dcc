// Planes through points, and how RANSAC (Fischler and Bolles 1981) draws them: what the loops of surveys and of scans
// share.
#pragma once

#include <algorithm>
#include <cmath>

#include "bumpytiles/arrays.hpp"

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

}  // namespace bumpy
