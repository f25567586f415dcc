// Fills the unknown pixels of a heightmap from their neighbours. Ours.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "bumpytiles/arrays.hpp"

namespace bumpy {

// Fills pixels that are NaN, counted row by row, with the mean of their known 8 neighbours, from the rim inwards,
// `depth` rings deep; sums run in the precision of the heights. Returns the number of pixels still unknown.
template <class Number>
Index fill_holes(Array<Number, 2> heights, std::vector<Index> holes, Index depth) {
    const Index rows = heights.shape[0], cols = heights.shape[1];
    std::vector<Number> values(holes.size());
    for (Index ring = 0; ring < depth && !holes.empty(); ++ring) {
        for (std::size_t k = 0; k < holes.size(); ++k) {
            const Index row = holes[k] / cols, col = holes[k] % cols;
            Number total = 0, known = 0;
            for (Index r = std::max<Index>(0, row - 1); r < std::min(rows, row + 2); ++r)
                for (Index c = std::max<Index>(0, col - 1); c < std::min(cols, col + 2); ++c) {
                    const Number height = heights(r, c);
                    const bool is_known = !std::isnan(height);
                    total += is_known ? height : Number{0};
                    known += is_known ? Number{1} : Number{0};
                }
            values[k] = known > 0 ? total / known : std::numeric_limits<Number>::quiet_NaN();
        }
        std::size_t left = 0;
        for (std::size_t k = 0; k < holes.size(); ++k) {
            heights.data[holes[k]] = values[k];
            if (std::isnan(values[k])) holes[left++] = holes[k];
        }
        holes.resize(left);
    }
    return static_cast<Index>(holes.size());
}

// All of them.
template <class Number>
Index fill_all_holes(Array<Number, 2> heights, Index depth) {
    std::vector<Index> holes;
    for (Index k = 0; k < heights.count(); ++k)
        if (std::isnan(heights.data[k])) holes.push_back(k);
    return fill_holes(heights, holes, depth);
}

}  // namespace bumpy
