// Finds the ground of a scan: a plane for every cell of the polar grid, which points lie on it, and where it drops.
//
// Each cell's plane starts at the lowest points of its parts and is fitted again to the points near it. It must
// continue the planes around it; where it does not, it starts again from theirs. A cell without a plane of its own
// passes theirs on. Parts beside a plane that continue it are ground too. What lies behind an edge is not seen, and a
// plane that is fitted to both sides passes over it: so the ground is followed outwards, and if what is seen next lies
// too far below where it should go on, there is an edge in between. Sums run in the order of the scan's points. Ours.
#include <algorithm>
#include <array>
#include <limits>
#include <vector>

#include "polar.hpp"

namespace bumpy {
namespace {

// Parts of a cell along each side: outwards and around; PARTS in ground.py.
constexpr Index parts = 5;
constexpr Index parts_of_cell = parts * parts;
// Most neighbours of a cell: three inwards, two beside it, three outwards; NEIGHBOURS in ground.py.
constexpr std::size_t most_neighbours = 8;
// Kinds of planes: passed on by a neighbour; fitted to the cell's own points; passed on before the second round, for
// where nothing better is known. 0: none.
constexpr std::int32_t carried = 1, found = 2, guessed = 3;
constexpr double infinite = std::numeric_limits<double>::infinity();

struct CellGeometry {
    Array<const double> x, y;
    Array<const std::int32_t, 2> near;
    Array<const std::int32_t> zone, ring, sector, first, rings, sectors;

    Index cells() const { return x.size(); }
};

struct Place {
    double x, y;
};

// A plane by its slope along x and y, and its height at the origin, m.
struct Slope {
    double a, b, c;

    double height(double x, double y) const { return a * x + b * y + c; }
};

struct GroundPlanes {
    Array<double, 2> plane, centre;
    Array<double> spread;
    Array<std::int32_t> kind;

    Slope at(Index cell) const { return {plane(cell, 0), plane(cell, 1), plane(cell, 2)}; }
};

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

// What the planes around a cell expect at a place.
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
    std::array<double, most_neighbours> heights;
    std::array<Index, most_neighbours> cells;
    for (const std::int32_t worst : {found, guessed}) {
        std::size_t count = 0;
        for (Index s = 0; s < last; ++s) {
            const Index other = geometry.near(cell, s);
            if (other < 0 || planes.kind[other] == 0 || planes.kind[other] > worst) continue;
            const double u = planes.centre(other, 0), v = planes.centre(other, 1);
            double height = planes.at(other).height(u + own_slope * (at.x - u), v + own_slope * (at.y - v));
            height += (1.0 - own_slope) * (slope[0] * (at.x - u) + slope[1] * (at.y - v));
            std::size_t k = count++;
            for (; k > 0 && heights[k - 1] > height; --k) {
                heights[k] = heights[k - 1];
                cells[k] = cells[k - 1];
            }
            heights[k] = height;
            cells[k] = other;
        }
        if (count == 0) continue;
        const std::size_t middle = (count - 1) / 2;
        const Index other = cells[middle];
        const double dx = at.x - planes.centre(other, 0), dy = at.y - planes.centre(other, 1);
        return {other, heights[middle], std::sqrt(dx * dx + dy * dy) + planes.centre(other, 2), worst};
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
    double n = 0.0, su = 0.0, sv = 0.0, sh = 0.0, suu = 0.0, suv = 0.0, svv = 0.0, suh = 0.0, svh = 0.0;
    double near = 0.0, square = 0.0;
    for (Index i = some.first; i < some.end; i += some.step) {
        const double x = xyz(0, i), y = xyz(1, i);
        const double u = x - origin.x, v = y - origin.y;
        const double h = xyz(2, i) - plane.height(x, y);
        if (band.low < h && h < band.high) {
            n += 1.0;
            su += u;
            sv += v;
            sh += h;
            suu += u * u;
            suv += u * v;
            svv += v * v;
            suh += u * h;
            svh += v * h;
        }
        if (std::abs(h) < band.reach) {
            near += 1.0;
            square += h * h;
        }
    }
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
    std::array<double, parts_of_cell> height, x, y, z;  // m; height above the expected plane; infinite: none
    std::array<double, tail_points> tail;               // increasing, m
};

// Finds them among the points that are not below `floor`; `most` heights of the tail.
Lowest find_lowest(const CellPoints& points, Some some, Slope plane, double floor, std::size_t most) {
    Lowest out;
    out.height.fill(infinite);
    out.tail.fill(infinite);
    for (Index i = some.first; i < some.end; i += some.step) {
        const double x = points.xyz(0, i), y = points.xyz(1, i), z = points.xyz(2, i);
        const double h = z - plane.height(x, y);
        if (h < floor) continue;
        const auto part = static_cast<std::size_t>(points.part[i]);
        if (h < out.height[part]) {
            out.height[part] = h;
            out.x[part] = x;
            out.y[part] = y;
            out.z[part] = z;
        }
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
    for (std::size_t k = 0; k < parts_of_cell; ++k) {
        if (lowest.height[k] == infinite) continue;
        low[count] = static_cast<float>(lowest.x[k]);
        low[parts_of_cell + count] = static_cast<float>(lowest.y[k]);
        low[2 * parts_of_cell + count] = static_cast<float>(lowest.z[k]);
        heights[count++] = lowest.height[k];
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
    planes.plane(cell, 0) = plane.a;
    planes.plane(cell, 1) = plane.b;
    planes.plane(cell, 2) = plane.c;
    planes.centre(cell, 0) = own.x;
    planes.centre(cell, 1) = own.y;
    planes.centre(cell, 2) = 0.0;
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
    planes.plane(cell, 0) = a;
    planes.plane(cell, 1) = b;
    planes.plane(cell, 2) = height - a * x - b * y;
    planes.centre(cell, 0) = x;
    planes.centre(cell, 1) = y;
    planes.centre(cell, 2) = away;
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
Index root_of(std::vector<Index>& of, Index cell) {
    const auto next = [&of](Index each) -> Index& { return of[static_cast<std::size_t>(each)]; };
    for (; next(cell) != cell; cell = next(cell)) next(cell) = next(next(cell));
    return cell;
}

// Whether the planes of two cells pass each other's points within what is allowed.
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
std::vector<Index> link_cells(const CellGeometry& geometry, const GroundPlanes& planes) {
    std::vector<Index> of(static_cast<std::size_t>(geometry.cells()));
    for (std::size_t cell = 0; cell < of.size(); ++cell) of[cell] = static_cast<Index>(cell);
    for (Index cell = 0; cell < geometry.cells(); ++cell) {
        for (Index k = 0; k < geometry.near.shape[1]; ++k) {
            const Index other = geometry.near(cell, k);
            if (other < 0 || planes.kind[cell] != found || planes.kind[other] != found) continue;
            if (!continues(cell, other, planes)) continue;
            const Index one = root_of(of, cell), two = root_of(of, other);
            of[static_cast<std::size_t>(std::max(one, two))] = std::min(one, two);
        }
    }
    return of;
}

// The largest set. A cell counts for the inverse of its distance: what lies near the robot is what it stands on.
Index largest_set(std::vector<Index>& of, const CellGeometry& geometry, const GroundPlanes& planes) {
    std::vector<double> weight(of.size());
    std::size_t best = 0;
    for (Index cell = 0; cell < geometry.cells(); ++cell) {
        if (planes.kind[cell] != found) continue;
        const auto root = static_cast<std::size_t>(root_of(of, cell));
        const double x = geometry.x[cell], y = geometry.y[cell];
        weight[root] += 1.0 / std::sqrt(x * x + y * y);
        if (weight[root] > weight[best]) best = root;
    }
    return static_cast<Index>(best);
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
    std::vector<Index> of = link_cells(geometry, planes), largest;
    const Index best = largest_set(of, geometry, planes);
    for (Index cell = 0; cell < cells; ++cell) {
        of[static_cast<std::size_t>(cell)] = root_of(of, cell);
        if (of[static_cast<std::size_t>(cell)] == best) largest.push_back(cell);
    }
    std::vector<Index> fit(of.size());
    for (Index cell = 0; cell < cells; ++cell) {
        const Index set = of[static_cast<std::size_t>(cell)];
        if (planes.kind[cell] != found || set == best) continue;
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
        fit[static_cast<std::size_t>(set)] += fits ? 1 : -1;
    }
    for (Index cell = 0; cell < cells; ++cell) {
        const Index set = of[static_cast<std::size_t>(cell)];
        if (set != best && fit[static_cast<std::size_t>(set)] <= 0) planes.kind[cell] = 0;
    }
}

// ---- The points on the ground ----

// Objects on the ground are drawn up to this multiple of the vehicle's height.
constexpr double objects_height = 2.0;
// Points further below a plane than this are reflections, m.
constexpr double below_plane = 0.5;
// A part beside the plane is ground too if it has so many points, spreads less than this, at a height between these,
// and passes a neighbouring part of the ground at less than this; its ground points are so near to their mean, m.
constexpr double part_points = 3.0, part_spread = 0.12, part_lowest = -0.6, part_highest = 1.2, part_step = 0.2;
constexpr double part_reach = 0.2;
// Returns in pixels next to each other lie together if their heights are so near to each other, m, at the sensor, and
// more for each metre from it; so many are an object.
constexpr double beside_m = 0.03, beside_per_metre = 0.04;
constexpr float together = 3.0F;
// Rounds in which the ground spreads to parts beside it.
constexpr int most_rounds = 6;
// Points further from a plane than this do not belong to the layer of the ground, m.
constexpr double layer = 1.5;
// Plants stand in a part if so high above its ground at most, m, there are points, as a share of those on it, and those
// on it spread by more than this multiple of the scan's noise and more than this, m.
constexpr double plants_above = 0.8, plants_share = 0.2, plants_spread = 1.8, plants_least = 0.045;

struct GroundRule {
    Array<const double> reach, noise;
    Index least_points;
    double belly, height;
};

struct GroundLabels {
    Array<float> height;
    Array<bool> ground;
    Array<std::int32_t> obstacles, overhead;
    Array<bool> airborne;
    Array<float> top, clearance;
    Array<float, 3> objects, lowest;
    Array<bool> kept;
    Array<std::int32_t> held;
};

enum class State : std::uint8_t { none, may_continue, continues_ground, is_grown, plants };

// A part of a cell, see `parts`.
struct Part {
    double count = 0.0, sum = 0.0, squares = 0.0, ground = 0.0;  // of the heights of its points
    double level = std::numeric_limits<double>::quiet_NaN();     // of its ground above the plane, m; NaN: it has none
    State state = State::none;

    double mean() const { return sum / count; }
};

// Points and cells while they are labelled.
struct Labelling {
    std::vector<float> heights;  // (points,) above the plane, by cell
    std::vector<Part> parts;     // (cells * parts_of_cell,)
    std::vector<bool> mixed;     // (cells,) whether some points are not on the plane

    Part& part(Index cell, Index inside) { return parts[static_cast<std::size_t>(cell * parts_of_cell + inside)]; }
    float height(Index i) const { return heights[static_cast<std::size_t>(i)]; }
    bool is_mixed(Index cell) const { return mixed[static_cast<std::size_t>(cell)]; }
};

// Finds the height of every point of a cell above its plane, and which lie on it; if not all do, sums by part.
void measure_heights(
    const CellPoints& points, Index cell, const GroundPlanes& planes, double zone_reach, Index least_points,
    Array<bool> kept, Labelling& s) {
    const Slope plane = planes.at(cell);
    const Index first = points.starts[cell], last = points.starts[cell + 1];
    const bool is_own = planes.kind[cell] == found;
    const double below = is_own ? -below_plane : -zone_reach;
    const double reach = !is_own && last - first > least_points ? -infinite : zone_reach;
    Index held = 0;
    for (Index i = first; i < last; ++i) {
        const double h = points.xyz(2, i) - plane.height(points.xyz(0, i), points.xyz(1, i));
        s.heights[static_cast<std::size_t>(i)] = static_cast<float>(h);
        kept[i] = below < h && h < reach;
        held += kept[i];
    }
    s.mixed[static_cast<std::size_t>(cell)] = held < last - first;
    for (Index i = first; i < last; ++i) {
        Part& part = s.part(cell, points.part[i]);
        const float h = s.height(i);
        if (held == last - first) {
            part.level = 0.0;
        } else if (std::abs(h) < layer) {
            part.count += 1.0;
            part.sum += h;
            part.squares += h * h;
            part.ground += kept[i];
        }
    }
}

// The part next to another one in the same zone; none beyond its border.
const Part* part_beside(
    Index cell, Index inside, Index outwards, Index around, const CellGeometry& geometry, Labelling& s) {
    const Index zone = geometry.zone[cell];
    const Index rows = geometry.rings[zone] * parts, columns = geometry.sectors[zone] * parts;
    const Index row = geometry.ring[cell] * parts + inside / parts + outwards;
    if (row < 0 || row >= rows) return nullptr;
    const Index column = (geometry.sector[cell] * parts + inside % parts + around + columns) % columns;
    const Index home = geometry.first[zone] + (row / parts) * geometry.sectors[zone] + column / parts;
    return &s.part(home, (row % parts) * parts + column % parts);
}

bool continues_beside(Index cell, Index inside, const CellGeometry& geometry, Labelling& s) {
    const double mean = s.part(cell, inside).mean();
    for (Index around = 0; around < 9; ++around) {
        const Part* other = part_beside(cell, inside, around / 3 - 1, around % 3 - 1, geometry, s);
        if (other != nullptr && std::abs(other->level - mean) < part_step) return true;
    }
    return false;
}

// Gives a level to parts that are ground, and to thin ones that continue them: kerbs, banks, terraces.
void grow(const CellGeometry& geometry, Labelling& s) {
    const auto of_mixed = [&](auto&& act) {
        for (Index cell = 0; cell < geometry.cells(); ++cell)
            for (Index inside = 0; inside < parts_of_cell && s.is_mixed(cell); ++inside) act(cell, inside);
    };
    of_mixed([&s](Index cell, Index inside) {
        Part& part = s.part(cell, inside);
        if (part.ground > 0.0 && part.ground >= 0.5 * part.count) {
            part.level = 0.0;
        } else if (part.count >= part_points) {
            const double mean = part.mean();
            const bool thin = part.squares / part.count - mean * mean < part_spread * part_spread;
            if (thin && part_lowest < mean && mean < part_highest) part.state = State::may_continue;
        }
    });
    bool grown = true;
    for (int round = 0; round < most_rounds && grown; ++round) {
        grown = false;
        of_mixed([&](Index cell, Index inside) {
            State& state = s.part(cell, inside).state;
            if (state != State::may_continue || !continues_beside(cell, inside, geometry, s)) return;
            state = State::continues_ground;
            grown = true;
        });
        of_mixed([&s](Index cell, Index inside) {
            Part& part = s.part(cell, inside);
            if (part.state != State::continues_ground) return;
            part.level = part.mean();
            part.state = State::is_grown;
        });
    }
}

// Adds the points of grown parts to the ground of a cell, and finds the parts in which plants rise from it.
void mark_plants(const CellPoints& points, Index cell, double reach, double least, Array<bool> kept, Labelling& s) {
    for (Index inside = 0; inside < parts_of_cell; ++inside) {
        Part& part = s.part(cell, inside);
        part.count = part.squares = part.sum = 0.0;
    }
    for (Index i = points.starts[cell]; i < points.starts[cell + 1]; ++i) {
        Part& part = s.part(cell, points.part[i]);
        const float h = s.height(i);
        if (part.state == State::is_grown) kept[i] = std::abs(h - part.level) < part_reach;
        if (kept[i]) {
            part.count += 1.0;
            part.squares += h * h;
        } else if (reach < h && h < reach + plants_above) {
            part.sum += 1.0;
        }
    }
    for (Index inside = 0; inside < parts_of_cell; ++inside) {
        Part& part = s.part(cell, inside);
        const bool rises = part.sum >= plants_share * part.count;
        part.state = rises && part.squares > least * least * part.count ? State::plants : State::none;
    }
}

// What is not ground in the pixels of a cell, up to `objects_height`: highest, lowest [m], and number.
struct Objects {
    Array<float> top, count;
    std::vector<float>& lowest;
};

// Takes returns that lie alone from the objects of a cell: fewer than three in a pixel and those next to it. The beams
// on an object lie side by side, so that its returns do; those from rain, dust or an insect lie alone.
void leave_out_airborne(const Objects& objects, double reach) {
    const auto& [top, count, lowest] = objects;
    const Index pixels = top.size();
    const auto side = static_cast<Index>(std::sqrt(static_cast<double>(pixels)) + 0.5);
    for (Index place = 0; place < pixels; ++place) {
        if (!(0.0F < count[place] && count[place] < together)) continue;
        const double low = lowest[static_cast<std::size_t>(place)] - reach, high = top[place] + reach;
        float beside = high - low < 3.0 * reach ? count[place] : 1.0F;
        const Index row = place / side, column = place % side;
        for (Index r = std::max(row - 1, Index{0}); r < std::min(row + 2, side); ++r) {
            for (Index c = std::max(column - 1, Index{0}); c < std::min(column + 2, side); ++c) {
                const Index k = r * side + c;
                const bool touches = lowest[static_cast<std::size_t>(k)] < high && top[k] > low;
                if (k != place && count[k] != 0.0F && touches) beside += std::abs(count[k]);
            }
        }
        if (beside < together) count[place] = -count[place];
    }
    for (Index place = 0; place < pixels; ++place)
        if (count[place] < 0.0F) top[place] = count[place] = 0.0F;
}

// Writes which points of a cell with a plane are ground, and what the others are.
void label_cell(
    const CellPoints& points, Index cell, const GroundRule& rule, const GroundLabels& out, const Objects& objects,
    Labelling& s) {
    const bool mixed = s.is_mixed(cell);
    const Array<float, 2> lowest = out.lowest.at(cell);
    for (Index i = points.starts[cell]; i < points.starts[cell + 1]; ++i) {
        const float h = s.height(i), z = points.xyz(2, i);
        const Index p = points.order[i], place = points.pixel[i];
        out.height[p] = h;
        if (!mixed || (out.kept[i] && s.part(cell, points.part[i]).state != State::plants)) {
            out.ground[p] = true;
            ++out.held[cell];
            lowest(place, 0) = std::min(lowest(place, 0), z);
            continue;
        }
        out.kept[i] = false;
        lowest(place, 1) = std::min(lowest(place, 1), z);
        if (h >= rule.height) {
            ++out.overhead[cell];
            out.clearance[cell] = std::min(out.clearance[cell], h);
        }
        if (0.0F < h && h < objects_height * rule.height) {
            float& low = objects.lowest[static_cast<std::size_t>(place)];
            low = objects.count[place] == 0.0F ? h : std::min(low, h);
            objects.top[place] = std::max(objects.top[place], h);
            objects.count[place] += 1.0F;
        }
    }
}

// Counts the points of obstacles in a cell, and marks those that lie alone.
void count_obstacles(
    const CellPoints& points, Index cell, const GroundRule& rule, const GroundLabels& out, const Objects& objects,
    const Labelling& s) {
    for (Index i = points.starts[cell]; i < points.starts[cell + 1]; ++i) {
        const float h = s.height(i);
        if (out.kept[i] || !(0.0F < h && h < objects_height * rule.height)) continue;
        if (objects.count[points.pixel[i]] == 0.0F) {
            out.airborne[points.order[i]] = true;
        } else if (rule.belly <= h && h < rule.height) {
            ++out.obstacles[cell];
            out.top[cell] = std::max(out.top[cell], h);
        }
    }
}

// Finds which points are ground, and in each cell what stands on the ground and what hangs over it.
void label_points(CellPoints points, CellGeometry geometry, GroundPlanes planes, GroundRule rule, GroundLabels out) {
    const auto cells = static_cast<std::size_t>(geometry.cells());
    Labelling s{
        std::vector<float>(static_cast<std::size_t>(out.kept.size())), std::vector<Part>(cells * parts_of_cell),
        std::vector<bool>(cells)};
    for (Index cell = 0; cell < geometry.cells(); ++cell)
        if (planes.kind[cell] != 0)
            measure_heights(points, cell, planes, rule.reach[geometry.zone[cell]], rule.least_points, out.kept, s);
    grow(geometry, s);
    std::vector<float> low(static_cast<std::size_t>(out.lowest.shape[1]));
    for (Index cell = 0; cell < geometry.cells(); ++cell) {
        const Index begin = points.starts[cell], end = points.starts[cell + 1];
        if (begin == end) continue;
        const Array<float, 2> lowest = out.lowest.at(cell);
        std::fill_n(lowest.data, lowest.count(), std::numeric_limits<float>::infinity());
        const Array<float, 2> drawn = out.objects.at(cell);
        std::fill_n(drawn.data, drawn.count(), 0.0F);
        const Objects objects{drawn.at(0), drawn.at(1), low};
        if (planes.kind[cell] == 0) {
            for (Index i = begin; i < end; ++i) {
                float& lowest_other = lowest(points.pixel[i], 1);
                lowest_other = std::min(lowest_other, points.xyz(2, i));
                out.kept[i] = false;
            }
            continue;
        }
        const Index zone = geometry.zone[cell];
        if (s.is_mixed(cell)) {
            const double least = std::max(plants_spread * rule.noise[zone], plants_least);
            mark_plants(points, cell, rule.reach[zone], least, out.kept, s);
        }
        label_cell(points, cell, rule, out, objects, s);
        if (s.is_mixed(cell)) {
            const double x = geometry.x[cell], y = geometry.y[cell];
            leave_out_airborne(objects, beside_m + beside_per_metre * std::sqrt(x * x + y * y));
            count_obstacles(points, cell, rule, out, objects, s);
        }
    }
}

// ---- Drops ----

struct DropRule {
    double least, slope, below, slope_x, slope_y;
    Index directions;
};

// The way outwards in one direction, and the last ground on it.
struct GroundWay {
    double east, north;                    // the direction
    Index last = -1, marked = -1;          // cells: of the last ground, and behind the last drop; -1: none yet
    double r = 0.0, z = 0.0, slope = 0.0;  // of the last ground: distance, height [m] and slope

    // Counts a drop before a return of a cell at a distance and a height, m, if there is one.
    void reach(Index cell, double at, double height, const DropRule& rule, Array<std::int32_t> drops) {
        if (last < 0) return;
        const double way = at - r, level = rule.slope_x * east + rule.slope_y * north;
        const double drop = z + slope * way - height, beam = height * r / at - z;
        if (!(drop > std::max(rule.least, rule.slope * way) && beam > rule.below)) return;
        if (!(z + level * way - height > 0.5 * rule.least)) return;
        drops[last] += marked != last;
        drops[cell] += cell != last && cell != marked;
        marked = cell;
    }
};

// Counts the directions in which the ground drops in every cell: for the last cell before a drop, and for that of what
// is seen below. Arrays as in `ground_drops` of ground.py.
void find_drops(
    Array<const float, 3> lowest, Array<const double, 2> slope, Array<const Index> starts, ZoneGrid grid, DropRule rule,
    Array<std::int32_t> drops) {
    const auto pixels = static_cast<double>(grid.pixels);
    for (Index direction = 0; direction < rule.directions; ++direction) {
        const double share = (static_cast<double>(direction) + 0.5) / static_cast<double>(rule.directions);
        const double turn = 2.0 * std::numbers::pi * (share + grid.start);
        GroundWay way{std::cos(turn), std::sin(turn)};
        Index first = 0;
        for (Index zone = 0; zone < grid.sectors.size(); ++zone) {
            const Index rings = grid.rings[zone], sectors = grid.sectors[zone];
            const double around = share * static_cast<double>(sectors);
            const auto sector = static_cast<Index>(around);
            const auto column = static_cast<Index>((around - static_cast<double>(sector)) * pixels);
            const double width = (grid.edges[zone + 1] - grid.edges[zone]) / static_cast<double>(rings * grid.pixels);
            for (Index ring = 0; ring < rings; ++ring) {
                const Index cell = first + ring * sectors + sector;
                if (starts[cell] == starts[cell + 1]) continue;
                for (Index row = 0; row < grid.pixels; ++row) {
                    const Index k = row * grid.pixels + column;
                    const bool is_ground = lowest(cell, k, 0) < infinite;
                    const double z = lowest(cell, k, is_ground ? 0 : 1);
                    if (z == infinite) continue;
                    const double r = grid.edges[zone] + (static_cast<double>(ring * grid.pixels + row) + 0.5) * width;
                    way.reach(cell, r, z, rule, drops);
                    if (!is_ground) continue;
                    way.last = cell;
                    way.r = r;
                    way.z = z;
                    way.slope = slope(cell, 0) * way.east + slope(cell, 1) * way.north;
                }
            }
            first += sectors * rings;
        }
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::CellGeometry, x, y, near, zone, ring, sector, first, rings, sectors)
BUMPY_RECORD(bumpy::GroundPlanes, plane, centre, spread, kind)
BUMPY_RECORD(bumpy::SearchRule, reach, least_points, neighbours, slope)
BUMPY_RECORD(bumpy::GroundRule, reach, noise, least_points, belly, height)
BUMPY_RECORD(
    bumpy::GroundLabels, height, ground, obstacles, overhead, airborne, top, clearance, objects, lowest, kept, held)
BUMPY_RECORD(bumpy::DropRule, least, slope, below, slope_x, slope_y, directions)

void bind_ground(nb::module_& module) {
    using namespace bumpy;
    BUMPY_LOOP(module, find_planes);
    BUMPY_LOOP(module, keep_largest);
    BUMPY_LOOP(module, label_points);
    BUMPY_LOOP(module, find_drops);
}
