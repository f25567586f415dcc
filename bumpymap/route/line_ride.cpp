// Heights under the wheels along a line, and a car that drives over them: holes beside the line are filled with the
// mean of their neighbours, all at once in each round; the quarter car is stepped from sample to sample (Sayers 1995).
// See line_ride.py and road_profile.py.
#include "bumpymap/core/fill_holes.hpp"
#include "bumpytiles/bindings.hpp"

namespace bumpy {
namespace {

// Fills holes of `heights`, which has one more pixel at all edges, in the tiles of `near`, (rows, cols).
void fill_near_holes(Array<double, 2> heights, Array<const bool, 2> near, Index rounds) {
    const Index rows = near.shape[0], cols = near.shape[1], pixels = (heights.shape[0] - 2) / rows;
    std::vector<Index> holes;
    for (Index row = 1; row <= rows * pixels; ++row)
        for (Index col = 1; col <= cols * pixels; ++col)
            if (near((row - 1) / pixels, (col - 1) / pixels) && std::isnan(heights(row, col)))
                holes.push_back(row * heights.shape[1] + col);
    fill_holes(heights, holes, rounds);
}

// Fills the difference of the slopes of body and wheel of a quarter car after each slope of a profile, (n,). `step` (4,
// 4): its state, from rest, after a sample; `push` (4,): what a slope adds to that.
void drive_quarter_car(
    Array<const double> slope, Array<const double, 2> step, Array<const double> push, Array<double> travel) {
    std::array<double, 4> state{};
    for (Index k = 0; k < slope.size(); ++k) {
        std::array<double, 4> next{};
        for (Index i = 0; i < 4; ++i)
            next[static_cast<std::size_t>(i)] = step(i, 0) * state[0] + step(i, 1) * state[1] + step(i, 2) * state[2] +
                                                step(i, 3) * state[3] + push[i] * slope[k];
        state = next;
        travel[k] = state[0] - state[2];
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_LOOPS(line_ride, fill_near_holes, drive_quarter_car)
