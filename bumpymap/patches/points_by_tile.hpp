// Points of tiles as the loops get them, see `PointsByTile` in features.py; stray ones among them.
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

struct PointsByTile {
    Array<const Index> starts;
    Array<const double> easting, northing, upward;
    Array<const Index> col, row;

    Index tiles() const { return col.size(); }

    // Points of the tile that has the most.
    Index most_points() const {
        Index most = 0;
        for (Index t = 0; t < tiles(); ++t) most = std::max(most, starts[t + 1] - starts[t]);
        return most;
    }
};

// Whether `stray_bounds` plainly finds none (low and high are the extremes of the distances): the gap beside a stray is
// wider than `gap` and than the spread of all that stays. So what stays reaches neither from the lowest third of the
// range into the highest, nor from one end of the range into the third at the other end; one of the outer thirds then
// holds strays alone, at most `most`.
inline bool has_no_strays(Array<const double> distance, Extremes range, double gap, Index most) {
    if (range.high - range.low <= gap) return true;
    const double third = (range.high - range.low) / 3.0;
    Index above = 0, below = 0;
    for (const double d : distance) {
        above += d > range.high - third;
        below += d < range.low + third;
    }
    return above > most && below > most;
}

// Splits off stray points: at most `most` on one side of a tile, cut off from all others by a gap that is wider than
// `gap` metres and wider than the spread of everything that stays: a rock or a tree has points at all its heights, a
// bird or a multipath echo has not. Returns between which distances points stay, m, and the number of strays. Ours.
inline std::tuple<double, double, Index> stray_bounds(Array<const double> distance, double gap, Index most) {
    const std::tuple none{-infinite, infinite, Index{0}};
    if (distance.size() < 2 * most + 2 || has_no_strays(distance, extremes(distance), gap, most)) return none;
    std::vector<double> top(static_cast<std::size_t>(most + 1)), bottom(top.size());
    std::partial_sort_copy(distance.begin(), distance.end(), top.begin(), top.end(), std::greater{});
    std::partial_sort_copy(distance.begin(), distance.end(), bottom.begin(), bottom.end());
    // Try the removal of t points above and b below; take the largest that leaves both cuts wide enough.
    for (Index total = 2 * most; total > 0; --total)
        for (Index above = std::max<Index>(0, total - most); above <= std::min(most, total); ++above) {
            const auto t = static_cast<std::size_t>(above), b = static_cast<std::size_t>(total - above);
            const double need = std::max(gap, top[t] - bottom[b]);
            if ((t == 0 || top[t - 1] - top[t] > need) && (b == 0 || bottom[b] - bottom[b - 1] > need))
                return {b > 0 ? bottom[b] : -infinite, t > 0 ? top[t] : infinite, total};
        }
    return none;
}

}  // namespace bumpy

BUMPY_RECORD(bumpy::PointsByTile, starts, easting, northing, upward, col, row)
