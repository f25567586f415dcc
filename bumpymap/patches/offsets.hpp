// The pixels around one.
#pragma once

#include <algorithm>
#include <vector>

namespace bumpy {

// Rows down and columns to the right.
struct Offset {
    int down, right;

    int square() const { return down * down + right * right; }
};

// All pixels up to `reach` away, the pixel itself and the nearest first, then row by row.
inline std::vector<Offset> nearest_offsets(int reach) {
    std::vector<Offset> offsets;
    for (int down = -reach; down <= reach; ++down)
        for (int right = -reach; right <= reach; ++right)
            if (const Offset offset{down, right}; offset.square() <= reach * reach) offsets.push_back(offset);
    std::stable_sort(
        offsets.begin(), offsets.end(), [](Offset one, Offset other) { return one.square() < other.square(); });
    return offsets;
}

}  // namespace bumpy
