// Points of tiles as the loops get them, and how they are measured: `TilePoints` of bumpytiles and `FeatureSettings` of
// config.py; stray points among them.
#pragma once

#include <functional>
#include <tuple>
#include <vector>

#include "bumpymap/patches/sums.hpp"
#include "bumpytiles/bindings.hpp"
#include "bumpytiles/grouping.hpp"

namespace bumpy {

// Points on a pixel in a thin survey, at most.
constexpr double thin = 0.4;

struct Grid {
    double tile_size;
    Index pixels;
};

struct TilePoints {
    Grid grid;
    Array<const Index> starts;
    Array<const double> easting, northing, upward;
    Array<const Index> col, row;

    Index tiles() const { return col.size(); }
};

struct FeatureSettings {
    double ransac_threshold, stray_gap;
    Index stray_points;
};

// Splits off stray points: at most `most` on one side of a tile, cut off from all others by a gap that is wider than
// `gap` metres and wider than the spread of everything that stays: a rock or a tree has points at all its heights, a
// bird or a multipath echo has not. Returns between which distances points stay, m, and the number of strays. Ours.
inline std::tuple<double, double, Index> stray_bounds(Array<const double> distance, double gap, Index most) {
    const std::tuple none{-infinite, infinite, Index{0}};
    if (distance.size() < 2 * most + 2) return none;
    const auto [low, high] = extremes(distance);
    if (high - low <= gap) return none;
    std::vector<double> top(most + 1), bottom(most + 1);
    std::partial_sort_copy(distance.begin(), distance.end(), top.begin(), top.end(), std::greater{});
    std::partial_sort_copy(distance.begin(), distance.end(), bottom.begin(), bottom.end());
    // Try the removal of t points above and b below; take the largest that leaves both cuts wide enough.
    for (Index total = 2 * most; total > 0; --total)
        for (Index above = std::max<Index>(0, total - most); above <= std::min(most, total); ++above) {
            const Index t = above, b = total - above;
            const double need = std::max(gap, top[t] - bottom[b]);
            if ((t == 0 || top[t - 1] - top[t] > need) && (b == 0 || bottom[b] - bottom[b - 1] > need))
                return {b > 0 ? bottom[b] : -infinite, t > 0 ? top[t] : infinite, total};
        }
    return none;
}

}  // namespace bumpy

BUMPY_RECORD(bumpy::Grid, tile_size, pixels)
BUMPY_RECORD(bumpy::FeatureSettings, ransac_threshold, stray_gap, stray_points)
BUMPY_RECORD(bumpy::TilePoints, grid, starts, easting, northing, upward, col, row)
