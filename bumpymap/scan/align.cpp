// The frames of a drive held against each other: nearest ranges by direction, and objects laid on objects.
//
// A range image holds the nearest return in every direction of the sensor. A place is seen through if all beams near
// its direction end well behind it, hidden if all end well before it. Objects of one frame are drawn from above, and
// those of another one laid on the drawing, for many moves and turns at once. Ours.
#include <algorithm>
#include <cmath>
#include <limits>

#include "polar.hpp"

namespace bumpy {
namespace {

// Farthest distance of a range image, cm: that of 16 bits.
constexpr Index most_cm = std::numeric_limits<std::uint16_t>::max();

// A direction in a range image, and the distance there, m.
struct Sight {
    Index row, column;
    double away;
};

// `lowest`: elevation of the lower edge of row 0, as a share of a turn. A row is as high as a column is wide.
Sight sight_of(double x, double y, double z, double lowest, Index columns) {
    const auto wide = static_cast<double>(columns);
    const double flat = std::sqrt(x * x + y * y);
    const auto row = static_cast<Index>(std::floor((turn_of(flat, z) - lowest) * wide));
    const auto column = std::min(static_cast<Index>((turn_of(x, y) + 0.5) * wide), columns - 1);
    return {row, column, std::sqrt(flat * flat + z * z)};
}

// Finds the distance of the nearest point (points, 3) [m, in the frame of the sensor] in every direction, cm; `image`
// is 0 on entry, and where no point is.
void range_image(Array<const float, 2> points, double lowest, Array<std::uint16_t, 2> image) {
    for (Index i = 0; i < points.shape[0]; ++i) {
        const Sight sight = sight_of(points(i, 0), points(i, 1), points(i, 2), lowest, image.shape[1]);
        if (sight.row < 0 || sight.row >= image.shape[0]) continue;
        const auto away =
            static_cast<std::uint16_t>(static_cast<Index>(std::min(100.0 * sight.away, most_cm - 1.0)) + 1);
        std::uint16_t& nearest = image(sight.row, sight.column);
        if (nearest == 0 || away < nearest) nearest = away;
    }
}

// Counts a frame for the places that it saw through, from which it was hidden, that had no return near their direction,
// and that had returns near them; arrays as in `judge_by_view` of align.py.
void judge_places(
    Array<const std::int32_t, 2> place, Array<const double, 2> origin, double lowest,
    Array<const std::uint16_t, 2> image, Array<const double> limits, Array<std::int32_t, 2> found) {
    const Index rows = image.shape[0], columns = image.shape[1];
    for (Index v = 0; v < place.shape[0]; ++v) {
        const double px = place(v, 0) * 0.001, py = place(v, 1) * 0.001, pz = place(v, 2) * 0.001;
        const auto along = [&](Index axis) {
            return origin(axis, 0) * px + origin(axis, 1) * py + origin(axis, 2) * pz + origin(axis, 3);
        };
        const auto [row, column, away] = sight_of(along(0), along(1), along(2), lowest, columns);
        if (away > limits[0] || !(0 < row && row < rows - 1)) continue;
        int nearest = most_cm, farthest = 0;
        for (Index up = -1; up <= 1; ++up) {
            for (Index left = -1; left <= 1; ++left) {
                const int seen = image(row + up, (column + left + columns) % columns);
                if (seen == 0) continue;
                nearest = std::min(nearest, seen);
                farthest = std::max(farthest, seen);
            }
        }
        const double slack = away * limits[2] + limits[1];
        if (farthest == 0) {
            ++found(2, v);
        } else if (image(row, column) > 0 && nearest * 0.01 > away + slack) {
            ++found(0, v);
        } else if (farthest * 0.01 < away - slack) {
            ++found(1, v);
        } else {
            ++found(3, v);
        }
    }
}

// Draws objects (n, 3) [m, along the axes of the world] around a sensor, which is in the middle, seen from above: 4 in
// the cell of an object, 2 beside it, 1 at its corners; 0 on entry.
void draw_objects(Array<const float, 2> objects, double cell_m, Array<std::uint8_t, 2> drawn) {
    const Index rows = drawn.shape[0], columns = drawn.shape[1];
    for (Index i = 0; i < objects.shape[0]; ++i) {
        const auto column = static_cast<Index>(std::floor(objects(i, 0) / cell_m)) + columns / 2;
        const auto row = static_cast<Index>(std::floor(objects(i, 1) / cell_m)) + rows / 2;
        if (!(0 < row && row < rows - 1 && 0 < column && column < columns - 1)) continue;
        for (Index up = -1; up <= 1; ++up) {
            for (Index right = -1; right <= 1; ++right) {
                const auto ink = static_cast<std::uint8_t>(4 >> (std::abs(up) + std::abs(right)));
                drawn(row + up, column + right) = std::max(drawn(row + up, column + right), ink);
            }
        }
    }
}

// Adds up what is drawn at the places of objects (n, 3) [m, around their sensor], for turns about it (turns, 2) [cosine
// and sine] and moves by whole cells: (turns, rows, columns), no move in the middle, 0 on entry. `middle` (2,): where
// their sensor is from that of the drawing, m.
void match_objects(
    Array<const float, 2> objects, Array<const double> middle, Array<const double, 2> turns, double cell_m,
    Array<const std::uint8_t, 2> drawn, Array<std::int32_t, 3> found) {
    const Index high = found.shape[1], wide = found.shape[2];
    const Index rows = drawn.shape[0], columns = drawn.shape[1];
    for (Index turn = 0; turn < found.shape[0]; ++turn) {
        const double cosine = turns(turn, 0), sine = turns(turn, 1);
        for (Index i = 0; i < objects.shape[0]; ++i) {
            const double x = objects(i, 0), y = objects(i, 1);
            const double east = middle[0] + cosine * x - sine * y, north = middle[1] + sine * x + cosine * y;
            const Index column = static_cast<Index>(std::floor(east / cell_m)) + columns / 2 - wide / 2;
            const Index row = static_cast<Index>(std::floor(north / cell_m)) + rows / 2 - high / 2;
            if (!(0 <= row && row <= rows - high && 0 <= column && column <= columns - wide)) continue;
            for (Index up = 0; up < high; ++up) {
                const std::uint8_t* ink = &drawn(row + up, column);
                std::int32_t* sum = &found(turn, up, 0);
                for (Index right = 0; right < wide; ++right) sum[right] += ink[right];
            }
        }
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_LOOPS(align, range_image, judge_places, draw_objects, match_objects)
