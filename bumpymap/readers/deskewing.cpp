// Moves the points of a scan to where the sensor sees them at the time of the frame; see scans.py. Between two
// transforms a point moves along a line.
#include <algorithm>

#include "bumpytiles/bindings.hpp"

namespace bumpy {
namespace {

void move_points(
    Array<const float, 2> points, Array<const float> time, Array<const double, 3> transforms, double start, double step,
    Array<float, 2> moved) {
    const Index last = transforms.shape[0] - 2;
    for (Index i = 0; i < points.shape[0]; ++i) {
        const double place = (time[i] - start) / step;
        const Index k = std::min(std::max(static_cast<Index>(place), Index{0}), last);
        const double share = place - static_cast<double>(k);
        for (Index row = 0; row < 3; ++row) {
            double first = transforms(k, row, 3), second = transforms(k + 1, row, 3);
            for (Index column = 0; column < 3; ++column) {
                const double value = points(i, column);
                first += transforms(k, row, column) * value;
                second += transforms(k + 1, row, column) * value;
            }
            moved(i, row) = static_cast<float>(first + share * (second - first));
        }
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_LOOPS(deskewing, move_points)
