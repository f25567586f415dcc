// Sums of long arrays with the same bits on every processor.
//
// A processor adds eight numbers as fast as one, but only where the compiler may choose the order of the sum, and then
// the bits would depend on the processor. So the order is chosen here: a long sum runs in `lanes` partial sums side by
// side, number i in lane i % lanes, and the lanes are added at the end. Minima and maxima do not depend on an order at
// all.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "bumpytiles/grouping.hpp"

namespace bumpy {

constexpr double infinite = std::numeric_limits<double>::infinity();
constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();

// Partial sums side by side.
constexpr Index lanes = 64;

// Sum of value(0), value(1), ... value(count - 1).
template <class Function>
double sum_in_lanes(Index count, Function value) {
    double part[lanes] = {};
    Index first = 0;
    for (; first + lanes <= count; first += lanes)
        for (Index k = 0; k < lanes; ++k) part[k] += value(first + k);
    for (Index k = 0; first + k < count; ++k) part[k] += value(first + k);
    double total = 0.0;
    for (const double sum : part) total += sum;
    return total;
}

// Writes values minus their mean; returns the mean. The sum starts at the first value and so keeps its bits.
inline double centre(Array<const double> values, Array<double> out) {
    const double first = values[0];
    const double sum = sum_in_lanes(values.size(), [&](Index i) { return values[i] - first; });
    const double mean = first + sum / static_cast<double>(values.size());
    for (Index i = 0; i < values.size(); ++i) out[i] = values[i] - mean;
    return mean;
}

// Writes values [m] as seen from `start + middle`, by whole steps: the same bits wherever the start is.
inline void shift(Array<const double> values, double start, double middle, Array<double> out) {
    const double steps = std::rint(middle * steps_per_metre);
    for (Index i = 0; i < values.size(); ++i)
        out[i] = (std::rint((values[i] - start) * steps_per_metre) - steps) / steps_per_metre;
}

struct Extremes {
    double low, high;
};

// Least and greatest of at least one value, none of them NaN.
inline Extremes extremes(Array<const double> values) {
    constexpr Index side_by_side = 8;
    double low[side_by_side], high[side_by_side];
    for (Index k = 0; k < side_by_side; ++k) low[k] = high[k] = values[0];
    Index first = 0;
    for (; first + side_by_side <= values.size(); first += side_by_side)
        for (Index k = 0; k < side_by_side; ++k) {
            low[k] = std::min(low[k], values[first + k]);
            high[k] = std::max(high[k], values[first + k]);
        }
    Extremes found{*std::min_element(low, low + side_by_side), *std::max_element(high, high + side_by_side)};
    for (; first < values.size(); ++first)
        found = {std::min(found.low, values[first]), std::max(found.high, values[first])};
    return found;
}

}  // namespace bumpy
