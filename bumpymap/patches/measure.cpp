// The points of tiles in, measurements of tiles out.
//
// Points of a tile come in a canonical order (see bumpytiles/grouping.py), and the first k are a random sample of them.
// They are taken from the middle of the tile and its lowest point, so a tile that lies elsewhere has the same bits. Its
// planes are found: slope, strays and spread are those of the robust plane, which needs no draw, the residual that of
// RANSAC. Points far from all others are set aside, the rest fall into pixels, and the plane comes off these
// (heightmap.hpp). Ours, but for the residual: see docs/pages/measuring.md.
#include <nanobind/stl/tuple.h>

#include <array>
#include <numbers>
#include <tuple>

#include "bumpymap/patches/heightmap.hpp"
#include "bumpymap/patches/points_by_tile.hpp"

namespace bumpy {
namespace {

// ---- Planes of tiles: the robust plane, which needs no draw, and that of RANSAC, which the paper measures from.
//
// Both are weighted least-squares fits, repeated until they stand still. In single precision they are twice as fast,
// and it is enough to approach a plane; the last steps are in double precision. Points are centred: nothing here
// depends on where a tile lies. Nothing is drawn by chance either: candidates go through points that follow each other
// in the canonical order, which is that of a hash. So a tile that is turned by 90 degrees or mirrored has the same
// candidates, and one point more or less changes a few of them.

// Distance of a point whose weight for the robust plane is a quarter, m: of plants and stones, not of the ground.
constexpr double robust_scale = 0.1;
// Double steps of the robust plane, and steps of a RANSAC plane, at most: half of the roughest tiles need ten.
constexpr Index most_steps = 30;
// A plane that moves less stands still: radians, m.
constexpr double still = 1e-5;
// Times that an extrapolated step is as long as a plain one, at most.
constexpr double longest_step = 4.0;
// Points that candidates are compared on first.
constexpr Index sample_points = 256;
// Planes that RANSAC draws at most.
constexpr Index most_candidates = 150;
// Best candidates, which are fitted to all points; best of these, which are refined until they stand still.
constexpr std::size_t best_drawn = 8, best_refined = 2;
// Reach of the first fit to a candidate, in thresholds: its three points are noisy.
constexpr double wider = 1.5;
// Inner samples, and points of each: its inliers are fitted, and there are several even of rough ground.
constexpr Index inner_samples = 12, inner_points = 32;
// Steps after which a plane is given up whose loss is this multiple of the least.
constexpr Index trial_steps = 3;
constexpr double hopeless = 1.01;
// Rounding errors: points whose spreads have a product of less, as a share of their squared sum, are on a line.
template <class Number>
constexpr double line_error = 4096.0 * static_cast<double>(std::numeric_limits<Number>::epsilon());
// Of the loss of a point in whole numbers, whose sum does not depend on an order.
constexpr float loss_units = 1024.0F;
// Points whose units are added up at once: their sum is no larger than a whole number may be.
constexpr Index loss_strip = 1 << 16;

// ---- Weighted least squares ----

// Sums of weights w times 1, x, y, z, xx, xy, xz, yy, yz, zz.
using Moments = std::array<double, 10>;

struct FitSums {
    Moments moments;
    double loss;  // sum of min(1, (r / scale)^2), r the distances from the plane
};

constexpr Index fit_sums = 11;

// How the weight of a point follows from q = (r / scale)^2: Geman and McClure (1987), or 1 within the scale, 0 beyond.
enum class Weights { geman_mcclure, inliers };

// Adds the halves of the lanes of each sum until eight are left, then these in turn.
template <class Number>
FitSums fold_lanes(Number (&part)[fit_sums][lanes]) {
    for (auto& own : part) {
        for (Index k = 0; k < lanes / 2; ++k) own[k] += own[k + lanes / 2];
        for (Index k = 0; k < lanes / 4; ++k) own[k] += own[k + lanes / 4];
        for (Index k = 0; k < lanes / 8; ++k) own[k] += own[k + lanes / 8];
    }
    Number total[fit_sums] = {};
    for (Index k = 0; k < lanes / 8; ++k)
        for (Index m = 0; m < fit_sums; ++m) total[m] += part[m][k];
    FitSums sums;
    std::copy_n(total, fit_sums - 1, sums.moments.begin());
    sums.loss = static_cast<double>(total[fit_sums - 1]);
    return sums;
}

template <Weights weights, class Number>
FitSums sum_for_fit(const CentredPoints<Number>& points, const Plane& near, double scale) {
    const auto a = static_cast<Number>(near.a / scale), b = static_cast<Number>(near.b / scale),
               c = static_cast<Number>(near.c / scale), d = static_cast<Number>(near.d / scale);
    Number part[fit_sums][lanes] = {};
    for (Index start = 0; start < points.size(); start += lanes) {
        const Index count = std::min(lanes, points.size() - start);
        for (Index k = 0; k < count; ++k) {
            const Number x = points.x[start + k], y = points.y[start + k], z = points.z[start + k];
            const Number r = a * x + b * y + c * z + d, q = r * r;
            const Number root = 1 / (1 + q), is_near = q <= 1 ? 1 : 0;
            const Number w = weights == Weights::geman_mcclure ? root * root : is_near;
            const Number wx = w * x, wy = w * y, wz = w * z;
            part[0][k] += w;
            part[1][k] += wx;
            part[2][k] += wy;
            part[3][k] += wz;
            part[4][k] += wx * x;
            part[5][k] += wx * y;
            part[6][k] += wx * z;
            part[7][k] += wy * y;
            part[8][k] += wy * z;
            part[9][k] += wz * z;
            part[10][k] += q <= 1 ? q : 1;
        }
    }
    return fold_lanes(part);
}

// Least-squares plane of sums of points that are centred near zero, its normal upward: regression of heights where
// `is_level`, else along the axis whose 2 x 2 minor of the scatter matrix is the largest, so that steep planes are
// fitted as well as level ones. None where there are no three points or they lie on a line, up to a relative `error`.
Plane solve(const Moments& sums, bool is_level, double error) {
    auto [n, sx, sy, sz, xx, xy, xz, yy, yz, zz] = sums;
    if (n <= 0.0) return {};
    const double mx = sx / n, my = sy / n, mz = sz / n;
    xx -= sx * mx;
    xy -= sx * my;
    xz -= sx * mz;
    yy -= sy * my;
    yz -= sy * mz;
    zz -= sz * mz;
    const double minor_x = yy * zz - yz * yz, minor_y = xx * zz - xz * xz, minor_z = xx * yy - xy * xy;
    const double minor_xy = xz * yz - xy * zz, minor_xz = xy * yz - xz * yy, minor_yz = xy * xz - yz * xx;
    double a = minor_x, b = minor_xy, c = minor_xz;
    if (is_level || (minor_z >= minor_y && minor_z >= minor_x))
        std::tie(a, b, c) = std::tie(minor_xz, minor_yz, minor_z);
    else if (minor_y >= minor_x)
        std::tie(a, b, c) = std::tie(minor_xy, minor_y, minor_yz);
    double length = std::sqrt(a * a + b * b + c * c);
    const double scatter = xx + yy + zz;
    if (length <= error * scatter * scatter) return {};
    if (c < 0.0) length = -length;
    a /= length;
    b /= length;
    c /= length;
    return {a, b, c, -(a * mx + b * my + c * mz)};
}

struct Candidate {
    Plane plane;
    double loss = infinite;
};

// Fits a plane to points weighted by their distance from the plane `near`; the loss is that of `near`.
template <Weights weights, class Number>
Candidate fit_plane(const CentredPoints<Number>& points, const Plane& near, double scale) {
    const FitSums sums = sum_for_fit<weights>(points, near, scale);
    return {solve(sums.moments, false, line_error<Number>), sums.loss};
}

// Sum of min(1, (r / scale)^2), quickly; infinite where there is no plane.
double loss_of(const CentredPoints<float>& points, const Plane& plane, double scale) {
    if (!plane.is_found()) return infinite;
    const auto a = static_cast<float>(plane.a / scale), b = static_cast<float>(plane.b / scale),
               c = static_cast<float>(plane.c / scale), d = static_cast<float>(plane.d / scale);
    double total = 0.0;
    for (Index start = 0; start < points.size(); start += loss_strip) {
        std::int32_t units = 0;
        for (Index i = start; i < std::min(points.size(), start + loss_strip); ++i) {
            const float r = a * points.x[i] + b * points.y[i] + c * points.z[i] + d;
            units += static_cast<std::int32_t>(loss_units * std::min(1.0F, r * r));
        }
        total += static_cast<double>(units) / static_cast<double>(loss_units);
    }
    return total;
}

// ---- The robust plane ----

struct Step {
    Plane plane;
    double length;
};

// Where a plane that moves from the first to the third will stand still, and how far it moved at first. SQUAREM
// (Varadhan and Roland 2008): steps that hardly change are made longer.
Step extrapolate(const Plane& first, const Plane& second, const Plane& third) {
    const auto minus = [](const Plane& p, const Plane& q) { return Plane{p.a - q.a, p.b - q.b, p.c - q.c, p.d - q.d}; };
    const auto size = [](const Plane& p) { return std::sqrt(p.a * p.a + p.b * p.b + p.c * p.c + p.d * p.d); };
    const Plane step = minus(second, first), change = minus(minus(third, second), step);
    const double length = size(step), bend = size(change);
    const double way = bend > 0.0 ? std::min(std::max(length / bend, 1.0), longest_step) : 1.0;
    const double twice = 2.0 * way, square = way * way;
    const double a = first.a + twice * step.a + square * change.a, b = first.b + twice * step.b + square * change.b,
                 c = first.c + twice * step.c + square * change.c, d = first.d + twice * step.d + square * change.d;
    double norm = std::sqrt(a * a + b * b + c * c);
    if (c < 0.0) norm = -norm;
    return {{a / norm, b / norm, c / norm, d / norm}, length};
}

// The moments of each quarter of a tile, and of all of it behind them.
std::array<Moments, 5> quarter_moments(const CentredPoints<double>& points) {
    std::array<Moments, 5> sums{};
    for (Index i = 0; i < points.size(); ++i) {
        const double x = points.x[i], y = points.y[i], z = points.z[i];
        const Moments terms{1.0, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z};
        Moments& own = sums[static_cast<std::size_t>(x > 0.0) + 2 * static_cast<std::size_t>(y > 0.0)];
        for (std::size_t m = 0; m < own.size(); ++m) own[m] += terms[m];
    }
    for (std::size_t m = 0; m < sums[4].size(); ++m) sums[4][m] = (sums[0][m] + sums[3][m]) + (sums[1][m] + sums[2][m]);
    return sums;
}

// Least-squares plane that explains most: of all points, or of a quarter of them, which may be free of objects. Where
// heights tell nothing, on a wall, it is one across them. None where the points span no plane.
Plane first_plane(const CentredPoints<double>& points, const CentredPoints<float>& singles) {
    const std::array<Moments, 5> sums = quarter_moments(points);
    Plane best = solve(sums[4], false, line_error<double>);
    double least = 2.0 * loss_of(singles, best, robust_scale);
    for (std::size_t part = sums.size(); part-- > 0;) {
        const Plane plane = solve(sums[part], true, line_error<double>);
        const double loss = loss_of(singles, plane, robust_scale);
        if (loss < least || (part == 4 && loss <= least)) {
            best = plane;
            least = loss;
        }
    }
    return best;
}

// Plane of a tile by least squares, reweighted (Geman and McClure 1987) until it stands still. It starts from
// `first_plane`: no draw decides it. None where the points span no plane. `singles` are the same points.
Plane robust_plane(const CentredPoints<double>& points, const CentredPoints<float>& singles) {
    constexpr auto soft = Weights::geman_mcclure;
    Step step{first_plane(points, singles), infinite};
    Plane found = step.plane;
    for (Index i = 0; i < most_steps && found.is_found() && step.length > still; ++i) {
        const Plane second = fit_plane<soft>(singles, step.plane, robust_scale).plane;
        const Plane third = fit_plane<soft>(singles, second, robust_scale).plane;
        if (!second.is_found() || !third.is_found()) break;
        found = third;
        step = extrapolate(step.plane, second, third);
    }
    const Plane fitted = fit_plane<soft>(points, found, robust_scale).plane;
    return found.is_found() && fitted.is_found() ? fitted : found;
}

// ---- RANSAC ----

// Keeps a plane if it is one of those of least loss, the best first; of two with one loss, the first one first.
void keep_best(std::vector<Candidate>& best, std::size_t most, const Candidate& one) {
    if (!(one.loss < (best.size() < most ? infinite : best.back().loss))) return;
    if (best.size() == most) best.pop_back();
    const auto is_better = [](const Candidate& a, const Candidate& b) { return a.loss < b.loss; };
    best.insert(std::upper_bound(best.begin(), best.end(), one, is_better), one);
}

// Plane through three points that follow each other, then every second, third; none where they are on a line.
Plane candidate(const CentredPoints<double>& points, Index number) {
    const Index n = points.size(), i = number % n, step = number / n + 1;
    return plane_through(points, i, (i + step) % n, (i + 2 * step) % n);
}

// Draws of which one likely has inliers alone, if a plane has this loss a point.
Index draws_for(double loss) {
    const double share = 1.0 - loss;
    return draws_needed(std::min(std::max(share * share * share, 1e-6), 1.0 - 1e-9), most_candidates);
}

// The candidates with the least loss on a sample. It stops when a better one than the best, or than the plane `start`,
// has become improbable.
std::vector<Candidate> draw(
    const CentredPoints<double>& points, const CentredPoints<float>& singles, const Plane& start, double scale) {
    const Index n = std::min(points.size(), sample_points);
    const CentredPoints<float> sample = singles.slice(0, n);
    double least = loss_of(sample, start, scale);
    std::vector<Candidate> best;
    Index needed = draws_for(least / static_cast<double>(n));
    for (Index i = 0; i < needed; ++i) {
        const Plane plane = candidate(points, i);
        const double loss = loss_of(sample, plane, scale);
        if (loss < least) {
            least = loss;
            needed = draws_for(least / static_cast<double>(n));
        }
        keep_best(best, best_drawn, {plane, loss});
    }
    return best;
}

// Refines a plane on its inliers until its loss does not fall, or is far above `bound` after a few steps.
Candidate settle(Plane plane, double bound, double scale, const CentredPoints<float>& singles) {
    Candidate best{plane, infinite};
    for (Index step = 0; step < most_steps; ++step) {
        const auto [fitted, loss] = fit_plane<Weights::inliers>(singles, plane, scale);
        if (!(loss < best.loss) || (step >= trial_steps && loss > hopeless * bound)) break;
        best = {plane, loss};
        if (!fitted.is_found()) break;
        plane = fitted;
    }
    return best;
}

// Plane of a tile by RANSAC, locally optimised (Chum, Matas and Kittler 2003). It has the least loss of MSAC (Torr and
// Zisserman 2000) over all points, squared distances cut off at `scale`, of the candidates, of the robust plane, and of
// planes through inliers of the best of these: all are refined on their inliers.
Plane ransac_plane(
    const CentredPoints<double>& points, const CentredPoints<float>& singles, const Plane& robust, double scale) {
    constexpr auto hard = Weights::inliers;
    const auto fitted_to = [&](const CentredPoints<float>& some, const Plane& near) {
        const Plane plane = fit_plane<hard>(some, near, wider * scale).plane;
        return Candidate{plane, loss_of(singles, plane, scale)};
    };
    Candidate best = settle(robust, infinite, scale, singles);
    const auto settle_best = [&](const std::vector<Candidate>& candidates) {
        for (const Candidate& one : candidates) {
            const Candidate found = settle(one.plane, best.loss, scale, singles);
            if (found.loss < best.loss) best = found;
        }
    };
    std::vector<Candidate> refined;
    for (const Candidate& drawn : draw(points, singles, best.plane, scale))
        keep_best(refined, best_refined, fitted_to(singles, drawn.plane));
    settle_best(refined);

    std::vector<Candidate> inner;
    const Index room = points.size() - inner_points;
    const Index step = std::max<Index>(std::min(room, inner_samples * inner_points) / inner_samples, 1);
    for (Index first = 0; first < std::min(room, inner_samples * step); first += step)
        keep_best(inner, best_refined, fitted_to(singles.slice(first, first + inner_points), best.plane));
    settle_best(inner);
    Plane plane = best.plane;
    for (int i = 0; i < 2; ++i) {
        const Plane fitted = fit_plane<hard>(points, plane, scale).plane;
        if (!fitted.is_found()) break;
        plane = fitted;
    }
    return plane;
}

// ---- Tiles ----

// Columns of the scalars.
enum Scalar : Index { Z_MIN, Z_MAX, Z_VARIANCE, RESIDUAL, SLOPE, Z_RANGE, COVERAGE, RELIEF, STRAYS };

// Points of a tile in single precision.
struct SinglePoints {
    std::vector<float> x, y, z;

    explicit SinglePoints(const CentredPoints<double>& points)
        : x(points.x.begin(), points.x.end()),
          y(points.y.begin(), points.y.end()),
          z(points.z.begin(), points.z.end()) {}

    CentredPoints<float> all() const { return {view(x), view(y), view(z)}; }
};

// Finds the planes of centred points; fills residual, slope, and the distances to the robust plane, which it returns;
// heights where there is none.
Plane find_planes(
    const CentredPoints<double>& points, double threshold, std::vector<double>& distances, Array<double> scalars) {
    const SinglePoints singles(points);
    const Plane robust = robust_plane(points, singles.all());
    if (!robust.is_found()) {
        distances.assign(points.z.begin(), points.z.end());
        return robust;
    }
    const auto above = [&points](const Plane& plane, Index i) {
        return plane.above(points.x[i], points.y[i], points.z[i]);
    };
    const Plane drawn = ransac_plane(points, singles.all(), robust, threshold);
    const double sum = sum_in_lanes(points.size(), [&](Index i) { return std::abs(above(drawn, i)); });
    scalars[RESIDUAL] = sum / static_cast<double>(points.size());
    for (Index i = 0; i < points.size(); ++i) distances[i] = above(robust, i);
    scalars[SLOPE] = std::acos(std::min(1.0, robust.c)) * (180.0 / std::numbers::pi);
    return robust;
}

// Measures a tile. Its points are taken from its middle and their mean height.
void measure_tile(
    const TilePoints& points, Index t, const FeatureSettings& settings, Index depth, Array<double> scalars,
    const Heightmap& out) {
    const Index first = points.starts[t], last = points.starts[t + 1], n = last - first, size = out.heights.shape[0];
    const auto east = points.easting.slice(first, last), north = points.northing.slice(first, last);
    const auto up = points.upward.slice(first, last);
    const double side = points.grid.tile_size;
    const double west = static_cast<double>(points.col[t]) * side, south = static_cast<double>(points.row[t]) * side;
    std::vector<double> x(n), y(n), z(n), distances(n), levels(size * size);
    shift(east, west, side / 2.0, view(x));
    shift(north, south, side / 2.0, view(y));
    const auto [lowest, highest] = extremes(up);
    scalars[Z_MIN] = lowest;
    scalars[Z_MAX] = highest;
    shift(up, lowest, 0.0, view(distances));
    const double mean = lowest + centre(view(distances), view(z));
    scalars[Z_VARIANCE] = sum_in_lanes(n, [&](Index i) { return z[i] * z[i]; }) / static_cast<double>(n);

    const CentredPoints<double> centred{view(x), view(y), view(z)};
    const Plane plane = find_planes(centred, settings.ransac_threshold, distances, scalars);
    std::vector<std::int32_t> pixels(n);
    find_pixels(east, north, west, south, side, size, view(pixels));
    const auto [low, high, strays] = stray_bounds(view(distances), settings.stray_gap, settings.stray_points);
    if (strays > 0)
        for (Index i = 0; i < n; ++i)
            if (!(low <= distances[i] && distances[i] <= high)) pixels[i] = static_cast<std::int32_t>(size * size);
    std::vector<PixelSums> sums(size * size + 1);  // the last one takes the strays
    sum_by_pixel(view(pixels), centred, plane, view(sums));
    const Array<double, 2> level{levels.data(), {size, size}};
    const auto [known, range] = fill_heightmap(view(sums), mean, level, out);
    scalars[Z_RANGE] = range;
    scalars[COVERAGE] = static_cast<double>(known) / static_cast<double>(size * size);
    scalars[RELIEF] = fill_relief(level, depth, known == size * size, out.relief);
    scalars[STRAYS] = static_cast<double>(strays);
}

// Measures every tile that has points; the others get NaN, and no points. `depth`: deepest hole that is filled, px.
void measure_tiles(
    TilePoints points, FeatureSettings settings, Index depth, Array<double, 2> out, Array<float, 3> heights,
    Array<float, 3> variance, Array<float, 3> relief, Array<std::int32_t, 3> counts) {
    for (Index t = 0; t < points.tiles(); ++t) {
        const Array<double> scalars = out.at(t);
        std::fill(scalars.begin(), scalars.end(), not_a_number);
        const Heightmap maps{heights.at(t), variance.at(t), relief.at(t), counts.at(t)};
        if (points.starts[t] < points.starts[t + 1]) {
            measure_tile(points, t, settings, depth, scalars, maps);
            continue;
        }
        for (const Array<float, 2>& map : {maps.heights, maps.variance, maps.relief}) set_all(map, unknown_height);
        set_all(maps.count, 0);
    }
}

// ---- How the points of a tile differ, pair by pair ----
//
// The mean square of the differences of points close together is twice the noise variance, and a little ground. Ours.

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

void measure_pairs_of(
    const Heights& all, double side, const FeatureSettings& settings, double close, Array<double> out) {
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
        measure_pairs_of(own, side, settings, close, measures);
    }
}

}  // namespace
}  // namespace bumpy

void bind_measure(nb::module_& module) {
    using namespace bumpy;
    BUMPY_LOOP(module, measure_tiles);
    BUMPY_LOOP(module, measure_pairs);
    BUMPY_LOOP(module, stray_bounds);
    module.def("fill_holes", &fill_all_holes<double>, free_interpreter());
}
