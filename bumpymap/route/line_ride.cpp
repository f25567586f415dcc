// Heights under the wheels along a line: holes beside it are filled with the mean of their neighbours, all at once in
// each round. See line_ride.py.
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

}  // namespace
}  // namespace bumpy

BUMPY_LOOPS(line_ride, fill_near_holes)
