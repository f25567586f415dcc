// Finds the ground of a scan: a plane for every cell of the polar grid.
//
// Each cell's plane starts at the lowest points of its parts and is fitted again to the points near it. It must
// continue the planes around it; where it does not, it starts again from theirs. A cell without a plane of its own
// passes theirs on. At last, only the planes that continue each other around the robot stay. Sums run in the order of
// the scan's points. Ours; see `find_ground` of ground.py.
#include "ground.hpp"

#include <array>

namespace bumpy {
namespace {

// Most neighbours of a cell: three inwards, two beside it, three outwards; NEIGHBOURS in ground.py.
constexpr std::size_t most_neighbours = 8;
struct SearchRule {
    Array<const double> reach;
    Index least_points, neighbours;
    Array<const double> slope;
};

// ---- The plane of a cell ----

// Lowest points that may be reflections below the ground.
constexpr Index tail_points = 32;
// A gap in height, m, below which the few lowest points are reflections.
constexpr double gap = 0.3;
// Before the noise of the scan is known, points within this distance of a plane are its ground, m: first, most, least,
// and as a multiple of their root mean square.
constexpr double start_reach = 0.15, widest_reach = 0.3, narrowest_reach = 0.1, reach_of_spread = 2.5;
// The lowest points of parts within these heights of the plane through them are its start, m.
constexpr double above_lowest = 0.15, far_below = -1.0;
// Weight of the expected slope against the points', m^2 per root of their number: it decides if they lie on a line.
constexpr double ridge_weight = 0.02;
// How often a plane is fitted again to the points near it, in the first round and in the second.
constexpr int first_passes = 2, later_passes = 4;
// Slope of 38 degrees: tan(radians(38)) as Python rounds it.
const double steepest = std::tan(38.0 * (std::numbers::pi / 180.0));
// Fewest points of a plane.
constexpr double least_fitted = 8.0;
// A plane is fitted to every second, third ... point of a cell that has this many points twice, three times ...
constexpr Index most_fitted = 512;
// How far a plane may pass from what its neighbours expect, m: at their own points, for each metre from there, and the
// greatest distance that counts.
constexpr double step_at = 0.25, step_per_metre = 0.15, farthest = 8.0;
// How much farther than at their points a plane may pass above what its neighbours expect, for each metre from there;
// and above a guess. Below them it may pass at `step_per_metre`: a step up is an object more often than ground.
constexpr double rise_per_metre = 0.06, guessed_rise = 0.04;
// Weight of a plane's own slope against that of the whole ground, where it is followed to its neighbours.
constexpr double own_slope = 0.85;

// Every `step`-th of some points.
struct Some {
    Index first, end, step;
};

// The height that the planes around a cell expect at a place.
struct Expected {
    Index cell = -1;      // with the median height; -1: there are none
    double height = 0.0;  // m
    double away = 0.0;    // way from the place to the points of that cell, m
    std::int32_t worst = guessed;
};

// Planes that were guessed count where there are no others: `worst` is the kind of the worst that count.
Expected expect_from(
    Index cell, Index last, Place at, const CellGeometry& geometry, const GroundPlanes& planes,
    Array<const double> slope) {
    struct Height {
        double height;
        Index cell;
    };
    std::array<Height, most_neighbours> heights;
    for (const std::int32_t worst : {found, guessed}) {
        std::size_t count = 0;
        for (Index s = 0; s < last; ++s) {
            const Index other = geometry.near(cell, s);
            if (other < 0 || planes.kind[other] == 0 || planes.kind[other] > worst) continue;
            const double u = planes.centre(other, 0), v = planes.centre(other, 1);
            double height = planes.at(other).height(u + own_slope * (at.x - u), v + own_slope * (at.y - v));
            height += (1.0 - own_slope) * (slope[0] * (at.x - u) + slope[1] * (at.y - v));
            std::size_t k = count++;
            for (; k > 0 && heights[k - 1].height > height; --k) heights[k] = heights[k - 1];
            heights[k] = {height, other};
        }
        if (count == 0) continue;
        const auto [height, other] = heights[(count - 1) / 2];
        const double dx = at.x - planes.centre(other, 0), dy = at.y - planes.centre(other, 1);
        return {other, height, std::sqrt(dx * dx + dy * dy) + planes.centre(other, 2), worst};
    }
    return {};
}

// Heights above a plane of the points that another one is fitted to, and of those that tell its spread, m.
struct Band {
    double low, high, reach;
};

struct Fit {
    double count;
    double spread;  // root mean square of the heights of the points within the band's reach of the plane before, m
    Slope plane;
};

// Fits a plane to those of some points that lie in a band of another plane.
Fit fit_again(Array<const float, 2> xyz, Some some, Slope plane, Band band, Place origin, Place slope) {
    std::array<double, 9> sums{};
    double near = 0.0, square = 0.0;
    for (Index i = some.first; i < some.end; i += some.step) {
        const double x = xyz(0, i), y = xyz(1, i);
        const double u = x - origin.x, v = y - origin.y;
        const double h = xyz(2, i) - plane.height(x, y);
        const std::array<double, 9> terms{1.0, u, v, h, u * u, u * v, v * v, u * h, v * h};
        const bool counts = (band.low < h) & (h < band.high), is_near = std::abs(h) < band.reach;
        for (std::size_t m = 0; m < sums.size(); ++m) sums[m] += counts ? terms[m] : 0.0;
        near += is_near ? 1.0 : 0.0;
        square += is_near ? h * h : 0.0;
    }
    const auto [n, su, sv, sh, suu, suv, svv, suh, svh] = sums;
    if (n < 3.0) return {n, 0.0, plane};
    const double mu = su / n, mv = sv / n, mh = sh / n;
    const double ridge = ridge_weight * std::sqrt(n);
    const double uu = suu - su * mu + ridge, vv = svv - sv * mv + ridge, uv = suv - su * mv;
    const double uh = suh - su * mh + ridge * (slope.x - plane.a), vh = svh - sv * mh + ridge * (slope.y - plane.b);
    const double det = uu * vv - uv * uv;
    const double da = (uh * vv - vh * uv) / det, db = (vh * uu - uh * uv) / det;
    const double rise = mh - da * (mu + origin.x) - db * (mv + origin.y);
    return {n, std::sqrt(square / std::max(near, 1.0)), {plane.a + da, plane.b + db, plane.c + rise}};
}

// The lowest point of each part, and the lowest heights of all.
struct Lowest {
    struct Point {
        double height = infinite, x = 0.0, y = 0.0, z = 0.0;  // m; above the expected plane; infinite: none
    };
    std::array<Point, parts_of_cell> points;
    std::array<double, tail_points> tail;  // increasing, m
};

// Finds them among the points that are not below `floor`; `most` heights of the tail.
Lowest find_lowest(const CellPoints& points, Some some, Slope plane, double floor, std::size_t most) {
    Lowest out;
    out.tail.fill(infinite);
    for (Index i = some.first; i < some.end; i += some.step) {
        const double x = points.xyz(0, i), y = points.xyz(1, i), z = points.xyz(2, i);
        const double h = z - plane.height(x, y);
        if (h < floor) continue;
        Lowest::Point& lowest = out.points[static_cast<std::size_t>(points.part[i])];
        if (h < lowest.height) lowest = {h, x, y, z};
        if (h < out.tail[most - 1]) {
            std::size_t k = most - 1;
            for (; k > 0 && out.tail[k - 1] > h; --k) out.tail[k] = out.tail[k - 1];
            out.tail[k] = h;
        }
    }
    return out;
}

// Finds a plane through the lowest points of the cell's parts; returns false if there are fewer than three.
bool start_plane(const CellPoints& points, Some some, Slope expected, Place origin, Slope& plane) {
    const Index several = std::max((some.end - some.first) / (50 * some.step), Index{3});
    const auto most = static_cast<std::size_t>(std::min(several, tail_points - 1) + 1);
    Lowest lowest = find_lowest(points, some, expected, -infinite, most);
    double floor = -infinite;
    for (std::size_t k = 0; k + 1 < most; ++k)
        if (lowest.tail[k + 1] - lowest.tail[k] > gap) floor = lowest.tail[k + 1];
    if (floor > -infinite) lowest = find_lowest(points, some, expected, floor, most);
    std::array<float, 3 * parts_of_cell> low;
    std::array<double, parts_of_cell> heights;
    std::size_t count = 0;
    for (const auto [height, x, y, z] : lowest.points) {
        if (height == infinite) continue;
        low[count] = static_cast<float>(x);
        low[parts_of_cell + count] = static_cast<float>(y);
        low[2 * parts_of_cell + count] = static_cast<float>(z);
        heights[count++] = height;
    }
    if (count < 3) return false;
    std::sort(heights.begin(), heights.begin() + static_cast<Index>(count));
    const double median = 0.5 * (heights[(count - 1) / 2] + heights[count / 2]);
    plane = expected;
    Band band{-infinite, median + 0.05, 0.0};
    for (int pass = 0; pass < 3; ++pass) {
        const Fit fit = fit_again(
            {low.data(), {3, parts_of_cell}}, {0, static_cast<Index>(count), 1}, plane, band, origin,
            {expected.a, expected.b});
        if (fit.count < 3.0) return false;
        plane = fit.plane;
        band = {far_below, above_lowest, 0.0};
    }
    return true;
}

// Fits a plane `passes` times again to the points near it; returns whether enough are. `distance`: m, comes as the
// reach, goes as what counted as near; with a reach of zero it follows the spread of the points.
bool settle(
    const CellPoints& points, Some some, Slope& plane, double& distance, int passes, Place origin, Place slope) {
    const bool follows = !(distance > 0.0);
    if (follows) distance = start_reach;
    for (int pass = 0; pass < passes; ++pass) {
        const Fit fit = fit_again(points.xyz, some, plane, {-2.0 * distance, distance, distance}, origin, slope);
        plane = fit.plane;
        if (fit.count < 5.0) return false;
        if (follows) distance = std::min(std::max(reach_of_spread * fit.spread, narrowest_reach), widest_reach);
    }
    return true;
}

// Number, mean x and y, and spread in height of the points near a plane.
struct Described {
    double count, x, y, spread;
};

Described describe(const CellPoints& points, Some some, Slope plane, double reach) {
    double count = 0.0, sx = 0.0, sy = 0.0, sh = 0.0, square = 0.0;
    for (Index i = some.first; i < some.end; i += some.step) {
        const double x = points.xyz(0, i), y = points.xyz(1, i);
        const double h = points.xyz(2, i) - plane.height(x, y);
        if (!(std::abs(h) < reach)) continue;
        count += 1.0;
        sx += x;
        sy += y;
        sh += h;
        square += h * h;
    }
    if (count == 0.0) return {};
    const double mean = sh / count;
    return {count, sx / count, sy / count, std::sqrt(std::max(square / count - mean * mean, 0.0))};
}

// ---- The planes of all cells ----

// Keeps a plane if it has enough points, is not too steep and continues its neighbours'; returns whether it was.
bool accept(
    Index cell, Slope plane, const Described& own, const CellGeometry& geometry, const GroundPlanes& planes,
    const SearchRule& rule) {
    const double slope = plane.a * plane.a + plane.b * plane.b;
    if (own.count < least_fitted || slope > steepest * steepest) return false;
    const Expected near = expect_from(cell, rule.neighbours, {own.x, own.y}, geometry, planes, rule.slope);
    const double height = plane.height(own.x, own.y);
    if (near.cell >= 0) {
        const double over = height - near.height, far = std::min(near.away, farthest);
        if (over > step_at + rise_per_metre * far || -over > step_at + step_per_metre * far) return false;
    }
    if (planes.kind[cell] == guessed) {
        const double limit = step_at + guessed_rise * std::min(planes.centre(cell, 2), farthest);
        if (height - planes.at(cell).height(own.x, own.y) > limit) return false;
    }
    planes.put(cell, plane, {own.x, own.y}, 0.0);
    planes.spread[cell] = own.spread;
    planes.kind[cell] = found;
    return true;
}

// Gives a cell the plane of another one, `away` [m] from the points of that; -1: none.
void carry(
    Index cell, Index other, double away, std::int32_t kind, const CellGeometry& geometry, Array<const double> slope,
    const GroundPlanes& planes) {
    planes.kind[cell] = other >= 0 ? kind : 0;
    if (other < 0) return;
    const double x = geometry.x[cell], y = geometry.y[cell];
    double a = planes.plane(other, 0), b = planes.plane(other, 1);
    double height = planes.at(other).height(x, y);
    if (kind == guessed) {
        const double u = planes.centre(other, 0), v = planes.centre(other, 1);
        height = planes.at(other).height(u, v) + slope[0] * (x - u) + slope[1] * (y - v);
        a = slope[0];
        b = slope[1];
    }
    a = 0.5 * (a + slope[0]);
    b = 0.5 * (b + slope[1]);
    planes.put(cell, {a, b, height - a * x - b * y}, {x, y}, away);
}

// Finds a plane of the cell's own, from its lowest points or else from what its neighbours expect; false if none fits.
bool find_own(
    const CellPoints& points, Index cell, const Expected& near, const CellGeometry& geometry,
    const GroundPlanes& planes, const SearchRule& rule) {
    const Index first = points.starts[cell], count = points.starts[cell + 1] - first;
    if (count <= rule.least_points) return false;
    const Some some{first, first + count, std::max(count / most_fitted, Index{1})};
    const Place origin{geometry.x[cell], geometry.y[cell]};
    const Slope expected = near.cell >= 0 ? planes.at(near.cell) : Slope{rule.slope[0], rule.slope[1], 0.0};
    const Place slope{expected.a, expected.b};
    const double width = rule.reach[geometry.zone[cell]];
    const auto keeps = [&](Slope plane, double reach) {
        return accept(cell, plane, describe(points, some, plane, reach), geometry, planes, rule);
    };
    Slope plane = expected;
    double reach = width;
    const int passes = rule.neighbours > 0 ? later_passes : first_passes;
    if (start_plane(points, some, expected, origin, plane) &&
        settle(points, some, plane, reach, passes, origin, slope) && keeps(plane, reach))
        return true;
    if (near.cell < 0) return false;
    plane = expected;
    reach = widest_reach;
    if (!settle(points, some, plane, reach, 1, origin, slope)) return false;
    reach = width;
    return settle(points, some, plane, reach, later_passes - 1, origin, slope) && keeps(plane, reach);
}

// Finds the plane of the ground in every cell, from the sensor outwards.
void find_planes(CellPoints points, CellGeometry geometry, SearchRule rule, GroundPlanes planes) {
    const auto expected = [&](Index cell) {
        return expect_from(cell, rule.neighbours, {geometry.x[cell], geometry.y[cell]}, geometry, planes, rule.slope);
    };
    for (Index cell = geometry.cells() - 1; cell >= 0 && rule.neighbours > 0; --cell) {
        if (planes.kind[cell] != 0) continue;
        const Expected near = expected(cell);
        carry(cell, near.cell, near.away, guessed, geometry, rule.slope, planes);
    }
    for (Index cell = 0; cell < geometry.cells(); ++cell) {
        const Expected near = expected(cell);
        if (find_own(points, cell, near, geometry, planes, rule)) continue;
        carry(cell, near.cell, near.away, near.worst == found ? carried : guessed, geometry, rule.slope, planes);
    }
}

// ---- The largest set of planes that continue each other ----

// A plane whose points spread by more than this multiple of the noise, and by more than this, m, links nothing.
constexpr double rough = 2.5, rough_m = 0.06;

// The cell that stands for all that are linked to a cell; shortens the way to it.
Index root_of(Scratch<Index>& of, Index cell) {
    for (; of[cell] != cell; cell = of[cell]) of[cell] = of[of[cell]];
    return cell;
}

// True if the planes of two cells pass each other's points within what is allowed.
bool continues(Index cell, Index other, const GroundPlanes& planes) {
    const double x = planes.centre(cell, 0), y = planes.centre(cell, 1);
    const double u = planes.centre(other, 0), v = planes.centre(other, 1);
    const double dx = u - x, dy = v - y;
    const double limit = step_at + step_per_metre * std::min(std::sqrt(dx * dx + dy * dy), farthest);
    const Slope one = planes.at(cell), two = planes.at(other);
    const Slope between{one.a - two.a, one.b - two.b, one.c - two.c};
    return std::max(std::abs(between.height(x, y)), std::abs(between.height(u, v))) <= limit;
}

// The sets of cells that continue each other: of each cell, the one that stands for its set.
Scratch<Index> link_cells(const CellGeometry& geometry, const GroundPlanes& planes) {
    Scratch<Index> of(geometry.cells());
    for (Index cell = 0; cell < geometry.cells(); ++cell) of[cell] = cell;
    for (Index cell = 0; cell < geometry.cells(); ++cell) {
        for (Index k = 0; k < geometry.near.shape[1]; ++k) {
            const Index other = geometry.near(cell, k);
            if (other < 0 || planes.kind[cell] != found || planes.kind[other] != found) continue;
            if (!continues(cell, other, planes)) continue;
            const Index one = root_of(of, cell), two = root_of(of, other);
            of[std::max(one, two)] = std::min(one, two);
        }
    }
    return of;
}

// The largest set. A cell counts for the inverse of its distance: what lies near the robot is what it stands on.
Index largest_set(Scratch<Index>& of, const CellGeometry& geometry, const GroundPlanes& planes) {
    Scratch<double> weight(geometry.cells());
    Index best = 0;
    for (Index cell = 0; cell < geometry.cells(); ++cell) {
        if (planes.kind[cell] != found) continue;
        const Index root = root_of(of, cell);
        const double x = geometry.x[cell], y = geometry.y[cell];
        weight[root] += 1.0 / std::sqrt(x * x + y * y);
        if (weight[root] > weight[best]) best = root;
    }
    return best;
}

// Keeps the planes of the largest set of cells in which neighbours continue each other, and of sets as high as it.
//
// A plane whose points spread by much more than the `noise` (zones,) [m] of the scan continues nothing: it leans from
// the road to a roof. Another set is kept if most of its cells are as high as the nearest one of the largest, along the
// `slope` (2,) of the whole ground.
void keep_largest(CellGeometry geometry, GroundPlanes planes, Array<const double> noise, Array<const double> slope) {
    const Index cells = geometry.cells();
    for (Index cell = 0; cell < cells; ++cell)
        if (planes.spread[cell] > std::max(rough * noise[geometry.zone[cell]], rough_m)) planes.kind[cell] = 0;
    Scratch<Index> of = link_cells(geometry, planes), largest, fit(cells);
    const Index best = largest_set(of, geometry, planes);
    for (Index cell = 0; cell < cells; ++cell) {
        of[cell] = root_of(of, cell);
        if (of[cell] == best) largest.push_back(cell);
    }
    for (Index cell = 0; cell < cells; ++cell) {
        if (planes.kind[cell] != found || of[cell] == best) continue;
        const double x = planes.centre(cell, 0), y = planes.centre(cell, 1);
        double nearest = infinite, over = 0.0;
        for (const Index other : largest) {
            const double dx = x - planes.centre(other, 0), dy = y - planes.centre(other, 1);
            const double square = dx * dx + dy * dy;
            if (!(square < nearest)) continue;
            nearest = square;
            over = planes.at(cell).height(x, y) - slope[0] * dx - slope[1] * dy;
            over -= planes.at(other).height(x - dx, y - dy);
        }
        const double far = std::min(std::sqrt(nearest), farthest);
        const bool fits = -step_at - step_per_metre * far < over && over < step_at + rise_per_metre * far;
        fit[of[cell]] += fits ? 1 : -1;
    }
    for (Index cell = 0; cell < cells; ++cell)
        if (of[cell] != best && fit[of[cell]] <= 0) planes.kind[cell] = 0;
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::SearchRule, reach, least_points, neighbours, slope)

void bind_ground(nb::module_& module) {
    using namespace bumpy;
    BUMPY_LOOP(module, find_planes);
    BUMPY_LOOP(module, keep_largest);
}
