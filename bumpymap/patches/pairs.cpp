// How the points of a tile differ, pair by pair.
//
// The mean square of the differences of points close together is twice the noise variance, and a little ground. Ours.
#include <nanobind/stl/tuple.h>

#include "bumpymap/patches/heightmap.hpp"
#include "bumpymap/patches/points_by_tile.hpp"

namespace bumpy {
namespace {

// Points on a line, see `slopes_of`.
constexpr double line_of_points = 1e-6;
// Points that are measured, at least.
constexpr Index least_points = 4;

// Columns of what is filled.
enum Measure : Index { POINTS, SEEN_SHARE, TANGENT, SQUARES, PAIRS };

// Place and height above the plane of points, m.
struct Heights {
    Array<double> x, y, h;

    Heights slice(Index first, Index last) const {
        return {x.slice(first, last), y.slice(first, last), h.slice(first, last)};
    }
};

// Takes the least-squares plane off heights in place; returns its slopes, NaN where there is none.
Slopes take_plane_off(const Heights& points) {
    const auto& [x, y, h] = points;
    const auto n = static_cast<double>(x.size());
    const auto mean = [n](Array<double> values) {
        double sum = 0.0;
        for (const double value : values) sum += value;
        return sum / n;
    };
    const double mx = mean(x), my = mean(y), mz = mean(h);
    PlaneSums sums;
    for (Index i = 0; i < x.size(); ++i) sums.add(x[i] - mx, y[i] - my, h[i] - mz);
    const std::optional<Slopes> slopes = slopes_of(sums.xx, sums.xy, sums.yy, sums.xz, sums.yz, line_of_points);
    if (!slopes) return {not_a_number, not_a_number};
    for (Index i = 0; i < x.size(); ++i) h[i] -= mz + slopes->x * (x[i] - mx) + slopes->y * (y[i] - my);
    return *slopes;
}

// Moves the points that are no strays to the front; returns their number.
Index drop_strays(const Heights& points, double gap, Index most) {
    const auto& [x, y, h] = points;
    const auto [low, high, strays] = stray_bounds(h, gap, most);
    if (strays == 0) return h.size();
    Index n = 0;
    for (Index i = 0; i < h.size(); ++i)
        if (low <= h[i] && h[i] <= high) {
            x[n] = x[i];
            y[n] = y[i];
            h[n] = h[i];
            ++n;
        }
    return n;
}

// Share of the nine squares of a third of the side that hold a point, see `share_of_parts`.
double seen_share(const Heights& points, double side) {
    const auto third = [side](double place) {
        return std::min<Index>(static_cast<Index>(pixels_from(0.0, place, side, 3.0)), 2);
    };
    int seen = 0;
    for (Index i = 0; i < points.x.size(); ++i) seen |= 1 << (3 * third(points.y[i]) + third(points.x[i]));
    return share_of_parts(seen);
}

// Fills the sum of the squared differences of close pairs, and their number; `close`: square of a distance, m^2.
void add_pairs(const Heights& points, double close, Array<double> out) {
    const auto& [x, y, h] = points;
    double squares = 0.0, pairs = 0.0;
    for (Index i = 0; i < x.size(); ++i)
        for (Index j = 0; j < i; ++j) {
            const double u = x[i] - x[j], v = y[i] - y[j], w = h[i] - h[j];
            const bool is_close = u * u + v * v < close;
            squares += is_close ? w * w : 0.0;
            pairs += is_close ? 1.0 : 0.0;
        }
    out[SQUARES] = squares;
    out[PAIRS] = pairs;
}

void measure_tile(const Heights& all, double side, const FeatureSettings& settings, double close, Array<double> out) {
    auto [east, north] = take_plane_off(all);
    Heights points = all;
    const Index n = drop_strays(all, settings.stray_gap, settings.stray_points);
    if (n < all.x.size()) {
        points = all.slice(0, n);
        const Slopes more = take_plane_off(points);
        east += more.x;
        north += more.y;
    }
    if (std::isnan(east)) return;
    out[POINTS] = static_cast<double>(n);
    out[SEEN_SHARE] = seen_share(points, side);
    out[TANGENT] = std::sqrt(east * east + north * north);
    add_pairs(points, close, out);
}

// Measures the pairs of the first `limit` points of every tile; NaN where the points span no plane. `close`: square
// of the distance of close pairs, m^2.
void measure_pairs(
    TilePoints points, FeatureSettings settings, Array<const Index> limit, double close, Array<double, 2> out) {
    const double side = points.grid.tile_size;
    for (Index t = 0; t < points.tiles(); ++t) {
        const Index first = points.starts[t], n = std::min(points.starts[t + 1] - first, limit[t]);
        const Array<double> measures = out.at(t);
        std::fill(measures.begin(), measures.end(), not_a_number);
        if (n < least_points) continue;
        std::vector<double> x(n), y(n), h(n);
        const Heights own{view(x), view(y), view(h)};
        shift(points.easting.slice(first, first + n), static_cast<double>(points.col[t]) * side, 0.0, own.x);
        shift(points.northing.slice(first, first + n), static_cast<double>(points.row[t]) * side, 0.0, own.y);
        shift(points.upward.slice(first, first + n), points.upward[first], 0.0, own.h);
        measure_tile(own, side, settings, close, measures);
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_LOOPS(pairs, measure_pairs)
