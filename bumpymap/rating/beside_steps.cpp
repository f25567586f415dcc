// The nearest marked pixel of each pixel in its tile. Ours; see steps.py.
#include "bumpytiles/bindings.hpp"

namespace bumpy {
namespace {

// Fills place and squared distance, px, of the nearest marked pixel of the same tile: its row times the pixels of a
// side, and its column; of those as near, the westernmost, then the northernmost. -1 in tiles without any. All are
// (tiles, pixels, pixels).
void find_nearest(Array<const bool, 3> marks, Array<std::int32_t, 3> nearest, Array<std::int32_t, 3> squares) {
    const auto size = static_cast<std::int32_t>(marks.shape[1]);
    std::vector<std::int32_t> row_of(marks.shape[1] * marks.shape[1]);  // the nearest mark in the column; -1: none
    for (Index t = 0; t < marks.shape[0]; ++t) {
        const Array<const bool, 2> tile = marks.at(t);
        for (std::int32_t c = 0; c < size; ++c) {
            for (std::int32_t r = 0, last = -1; r < size; ++r) {
                if (tile(r, c)) last = r;
                row_of[r * size + c] = last;
            }
            for (std::int32_t r = size - 1, next = -1; r >= 0; --r) {
                std::int32_t& own = row_of[r * size + c];
                if (own == r) next = r;
                if (next >= 0 && (own < 0 || next - r < r - own)) own = next;
            }
        }
        for (std::int32_t r = 0; r < size; ++r) {
            for (std::int32_t c = 0; c < size; ++c) {
                std::int32_t found = -1, least = -1;
                for (std::int32_t col = 0; col < size; ++col) {
                    const std::int32_t row = row_of[r * size + col];
                    const std::int32_t square = (row - r) * (row - r) + (col - c) * (col - c);
                    if (row < 0 || (found >= 0 && square >= least)) continue;
                    found = row * size + col;
                    least = square;
                }
                nearest(t, r, c) = found;
                squares(t, r, c) = least;
            }
        }
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_LOOPS(beside_steps, find_nearest)
