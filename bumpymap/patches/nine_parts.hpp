// True if points lie everywhere in a tile, by the nine squares of a third of its side. Ours.
#pragma once

#include <bit>

namespace bumpy {

// Share of nine parts, a bit each, row by row, that hold a point; 0 if four that form a square hold none.
inline double share_of_parts(int seen) {
    constexpr int square = 0b000011011;
    for (const int corner : {0, 1, 3, 4})
        if ((seen & (square << corner)) == 0) return 0.0;
    return std::popcount(static_cast<unsigned>(seen)) / 9.0;
}

}  // namespace bumpy
