// Places the points of a scan on the polar grid, and measures its sectors: plane, spread and heightmap of each.
//
// Points are placed in blocks that stay in the nearest cache: first distance and direction of all, without a branch,
// then the cell of each; then they are listed by cell. A sector is measured in few passes through its ground points:
// their principal plane, a plane by RANSAC (Fischler and Bolles 1981), and the mean height above it in every pixel.
// Sums run in the order of the scan's points, so the same scan gives the same bits. Ours.
#include "polar.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <utility>

#include "bumpymap/core/planes.hpp"

namespace bumpy {
namespace {

// ---- The points by cell ----

// Points whose distance and direction are found at once.
constexpr Index block_points = 512;

// The cell, by zone, ring, sector, and the pixel at a distance [m] and a turn from sector 0; -1 outside of the grid.
std::pair<Index, Index> place_of(double r, double turn, const ZoneGrid& grid) {
    const auto& edges = grid.edges;
    const auto &sectors = grid.sectors, &rings = grid.rings;
    const Index pixels = grid.pixels;
    if (!(edges[0] <= r && r < edges[sectors.size()])) return {-1, -1};
    Index zone = 0, home = 0;
    for (; r >= edges[zone + 1]; ++zone) home += sectors[zone] * rings[zone];
    const double outward = (r - edges[zone]) / (edges[zone + 1] - edges[zone]) * static_cast<double>(rings[zone]);
    const double around = turn * static_cast<double>(sectors[zone]);
    const Index ring = std::min(static_cast<Index>(outward), rings[zone] - 1);
    const Index sector = std::min(static_cast<Index>(around), sectors[zone] - 1);
    const auto pixel_of = [pixels](double place, Index whole) {
        const double inside = (place - static_cast<double>(whole)) * static_cast<double>(pixels);
        return std::min(static_cast<Index>(inside), pixels - 1);
    };
    return {home + ring * sectors[zone] + sector, pixel_of(outward, ring) * pixels + pixel_of(around, sector)};
}

// Finds the cell of every point, -1 outside of the grid, and lists the points by cell.
void place_points(
    Array<const float, 2> points, ZoneGrid grid, Array<const std::int32_t> part_of_pixel, Array<std::int32_t> cell,
    CellPoints out) {
    const Index size = points.shape[0];
    Scratch<std::int32_t> pixel(size);
    std::array<double, block_points> x, y, distance, turn;
    for (Index begin = 0; begin < size; begin += block_points) {
        const auto count = static_cast<std::size_t>(std::min(block_points, size - begin));
        for (std::size_t i = 0; i < count; ++i) {
            const float* point = &points(begin + static_cast<Index>(i), 0);
            x[i] = point[0];
            y[i] = point[1];
        }
        for (std::size_t i = 0; i < count; ++i) {
            distance[i] = std::sqrt(x[i] * x[i] + y[i] * y[i]);
            double t = turn_of(x[i], y[i]) - grid.start;
            t = t < 0.0 ? t + 1.0 : t;
            turn[i] = t < 0.0 ? t + 1.0 : t;
        }
        for (std::size_t i = 0; i < count; ++i) {
            const auto [home, place] = place_of(distance[i], turn[i], grid);
            cell[begin + static_cast<Index>(i)] = static_cast<std::int32_t>(home);
            pixel[begin + static_cast<Index>(i)] = static_cast<std::int32_t>(place);
            if (home >= 0) ++out.starts[home + 2];
        }
    }
    for (Index c = 2; c < out.starts.size(); ++c) out.starts[c] += out.starts[c - 1];
    for (Index i = 0; i < size; ++i)
        if (cell[i] >= 0) out.order[out.starts[cell[i] + 1]++] = static_cast<std::int32_t>(i);
    for (Index i = 0; i < out.starts[out.starts.size() - 2]; ++i) {
        const Index p = out.order[i];
        for (Index axis = 0; axis < 3; ++axis) out.xyz(axis, i) = points(p, axis);
        out.pixel[i] = pixel[p];
        out.part[i] = part_of_pixel[out.pixel[i]];
    }
}

// ---- Planes of sectors ----

// Points that RANSAC scores candidates on, in equal steps through the sector's points.
constexpr Index sample_points = 128;
// Planes that RANSAC draws at most.
constexpr Index most_candidates = 200;
// A plane whose upward normal is less than this (steeper than 78 degrees) is a wall: only the mean height comes off.
constexpr double steepest = 0.2;
// Product of the two horizontal spreads over the square of their sum: less is one scan line, bent as the sector is.
constexpr double line_spread = 2e-3;
constexpr double infinite = std::numeric_limits<double>::infinity();

struct SectorInputs {
    Array<const bool> is_ground;
    Array<const Index> cells;
    double threshold;
};

struct SectorMeasures {
    Array<double, 2> scalars;
    Array<float, 2> normal;
    Array<float, 3> heights;
};

// The ground points of a sector, minus their mean.
struct SectorPoints {
    Scratch<double> x, y, z;
    Scratch<std::int32_t> pixel;

    Index size() const { return x.count(); }
    void resize(Index size) {
        for (auto* axis : {&x, &y, &z}) axis->resize(static_cast<std::size_t>(size));
        pixel.resize(static_cast<std::size_t>(size));
    }
    CentredPoints<double> centred() const { return {{x.data(), {size()}}, {y.data(), {size()}}, {z.data(), {size()}}}; }
};

// The symmetric scatter matrix of some points.
struct Scatter {
    double xx, xy, xz, yy, yz, zz;
};

// The unit eigenvector of the smallest eigenvalue, upward; zeros where none stands out. From below, Newton's steps on
// the characteristic polynomial climb to the smallest root and never pass it.
std::array<double, 3> least_axis(Scatter m) {
    const double trace = m.xx + m.yy + m.zz;
    if (!(trace > 0.0)) return {};
    const double minors = m.xx * m.yy - m.xy * m.xy + m.xx * m.zz - m.xz * m.xz + m.yy * m.zz - m.yz * m.yz;
    const double det =
        m.xx * (m.yy * m.zz - m.yz * m.yz) - m.xy * (m.xy * m.zz - m.yz * m.xz) + m.xz * (m.xy * m.yz - m.yy * m.xz);
    double root = 0.0;
    for (int round = 0; round < 60; ++round) {
        const double value = det - root * (minors - root * (trace - root));
        const double slope = minors - root * (2.0 * trace - 3.0 * root);
        if (slope <= 0.0) break;
        const double step = value / slope;
        root += step;
        if (std::abs(step) <= 1e-14 * trace) break;
    }
    const double xx = m.xx - root, yy = m.yy - root, zz = m.zz - root;
    // The eigenvector is upright on all rows; the longest product of two of them is the surest.
    const std::array<std::array<double, 3>, 3> products{{
        {m.xy * m.yz - m.xz * yy, m.xz * m.xy - xx * m.yz, xx * yy - m.xy * m.xy},
        {m.xy * zz - m.xz * m.yz, m.xz * m.xz - xx * zz, xx * m.yz - m.xy * m.xz},
        {yy * zz - m.yz * m.yz, m.yz * m.xz - m.xy * zz, m.xy * m.yz - yy * m.xz},
    }};
    const auto square = [](const std::array<double, 3>& p) { return p[0] * p[0] + p[1] * p[1] + p[2] * p[2]; };
    const double a = square(products[0]), b = square(products[1]), c = square(products[2]);
    const auto& axis = products[b > a && b >= c ? 1 : c > a ? 2 : 0];
    double length = std::sqrt(square(axis));
    if (length <= 1e-12 * trace * trace) return {};
    if (axis[2] < 0.0) length = -length;
    return {axis[0] / length, axis[1] / length, axis[2] / length};
}

struct PrincipalPlane {
    Plane plane;
    bool is_line;  // whether the points lie on one line, seen from above, if they are centred
};

// The plane of the least perpendicular spread of the points within `reach` of a plane; none if there are too few.
PrincipalPlane principal_plane(const CentredPoints<double>& points, Plane near, double reach) {
    std::array<double, 10> sums{};
    for (Index i = 0; i < points.size(); ++i) {  // without a branch, for it could not be foreseen
        const double u = points.x[i], v = points.y[i], w = points.z[i];
        const std::array<double, 10> terms{1.0, u, v, w, u * u, u * v, u * w, v * v, v * w, w * w};
        const bool counts = std::abs(near.above(u, v, w)) <= reach;
        for (std::size_t m = 0; m < sums.size(); ++m) sums[m] += counts ? terms[m] : 0.0;
    }
    const auto [n, sx, sy, sz, xx, xy, xz, yy, yz, zz] = sums;
    if (n < 3.0) return {};
    const double mx = sx / n, my = sy / n, mz = sz / n;
    const auto [a, b, c] =
        least_axis({xx - sx * mx, xy - sx * my, xz - sx * mz, yy - sy * my, yz - sy * mz, zz - sz * mz});
    const bool is_line = xx * yy - xy * xy < line_spread * (xx + yy) * (xx + yy);
    return {{a, b, c, -(a * mx + b * my + c * mz)}, is_line};
}

// The splitmix64 generator (Steele, Lea and Flood 2014).
std::uint64_t next_random(std::uint64_t& state) {
    state += 0x9E3779B97F4A7C15U;
    std::uint64_t z = state;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9U;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBU;
    return z ^ (z >> 31);
}

// Three numbers below n of 63 random bits.
std::array<Index, 3> three_below(std::uint64_t bits, std::uint64_t n) {
    const auto below = [=](int shift) { return static_cast<Index>((((bits >> shift) & 0x1FFFFF) * n) >> 21); };
    return {below(0), below(21), below(42)};
}

// The first points of a sector in equal steps. Single precision is enough to count those near a plane: coordinates
// start amid the points, so it errs by 1e-7 of the sector's side.
struct Sample {
    std::array<float, sample_points> x, y, z;
    Index size;

    explicit Sample(const CentredPoints<double>& points) : size(std::min(sample_points, points.size())) {
        for (Index i = 0; i < size; ++i) {
            const Index k = i * points.size() / size;
            x[static_cast<std::size_t>(i)] = static_cast<float>(points.x[k]);
            y[static_cast<std::size_t>(i)] = static_cast<float>(points.y[k]);
            z[static_cast<std::size_t>(i)] = static_cast<float>(points.z[k]);
        }
    }

    std::int32_t count_near(Plane plane, double threshold) const {
        const auto a = static_cast<float>(plane.a), b = static_cast<float>(plane.b), c = static_cast<float>(plane.c);
        const auto d = static_cast<float>(plane.d), reach = static_cast<float>(threshold);
        std::int32_t hits = 0;
        for (std::size_t i = 0; i < static_cast<std::size_t>(size); ++i)
            hits += std::abs(a * x[i] + b * y[i] + c * z[i] + d) <= reach;
        return hits;
    }
};

// The plane through three of the points that has the most of the sample within `threshold` [m]; none where none has
// any.
Plane best_candidate(const CentredPoints<double>& points, double threshold, std::uint64_t seed) {
    const Sample sample(points);
    Plane best;
    std::int32_t most = 0;
    Index needed = most_candidates;
    for (Index drawn = 0; drawn < needed; ++drawn) {
        const auto [i, j, k] = three_below(next_random(seed), static_cast<std::uint64_t>(points.size()));
        const Plane plane = plane_through(points, i, j, k);
        if (!plane.is_found()) continue;
        const std::int32_t hits = sample.count_near(plane, threshold);
        if (hits <= most) continue;
        most = hits;
        best = plane;
        const double share = static_cast<double>(hits) / static_cast<double>(sample.size);
        const double clean = share * share * share;  // chance that all three of a draw are inliers
        if (clean >= 1.0 - 1e-9) break;
        needed = draws_needed(clean, most_candidates);
    }
    return best;
}

// The plane by RANSAC, then twice the principal plane of its inliers; none where the points, centred, span none.
Plane ransac_plane(const CentredPoints<double>& points, double threshold, std::uint64_t seed) {
    Plane plane = best_candidate(points, threshold, seed);
    const double reach = plane.is_found() ? threshold : infinite;
    for (int round = 0; round < 2; ++round) {
        const Plane fitted = principal_plane(points, plane, reach).plane;
        if (!fitted.is_found()) break;
        plane = fitted;
    }
    return plane;
}

// ---- Measures of sectors ----

struct Centre {
    double x = 0.0, y = 0.0, z = 0.0;
    double variance = 0.0;  // of z, m^2
};

// Writes the ground points of a cell minus their mean, and returns that.
Centre centre_points(const CellPoints& points, Array<const bool> is_ground, Index cell, SectorPoints& out) {
    Index count = 0;
    out.resize(points.starts[cell + 1] - points.starts[cell]);
    for (Index i = points.starts[cell]; i < points.starts[cell + 1]; ++i) {
        out.x[count] = points.xyz(0, i);
        out.y[count] = points.xyz(1, i);
        out.z[count] = points.xyz(2, i);
        out.pixel[count] = points.pixel[i];
        count += is_ground[i];
    }
    out.resize(count);
    const auto n = static_cast<double>(count);
    Centre mean;
    for (Index i = 0; i < count; ++i) {
        mean.x += out.x[i];
        mean.y += out.y[i];
        mean.z += out.z[i];
    }
    mean.x /= n;
    mean.y /= n;
    mean.z /= n;
    for (Index i = 0; i < count; ++i) {
        out.x[i] -= mean.x;
        out.y[i] -= mean.y;
        out.z[i] -= mean.z;
        mean.variance += out.z[i] * out.z[i];
    }
    mean.variance /= n;
    return mean;
}

// Count and sum of the heights above a plane, by pixel.
struct PixelSums {
    Scratch<double> count, sum;
    double residual = 0.0;  // mean distance of the points from the plane, m
};

PixelSums sum_by_pixel(const SectorPoints& points, Plane plane, Index pixels) {
    const auto [a, b, c, d] = plane;
    const bool is_wall = !(c > steepest);
    const double east = is_wall ? 0.0 : -a / c, north = is_wall ? 0.0 : -b / c, level = is_wall ? 0.0 : -d / c;
    PixelSums out{Scratch<double>(pixels), Scratch<double>(pixels)};
    for (Index i = 0; i < points.size(); ++i) {
        const double x = points.x[i], y = points.y[i], z = points.z[i];
        const Index k = points.pixel[i];
        out.residual += std::abs(plane.above(x, y, z));
        out.count[k] += 1.0;
        out.sum[k] += z - east * x - north * y - level;
    }
    out.residual /= static_cast<double>(points.size());
    return out;
}

// Most pixels along a side of a heightmap, as `PolarSettings` allows.
constexpr std::size_t most_pixels = 64;

// An image with a margin of a pixel, where all neighbours exist.
struct Padded {
    Scratch<float> height, known;  // known: 1 or 0; unknown heights are 0

    explicit Padded(Index pixels) : height(pixels), known(pixels) {}
};

// The sum over the eight neighbours of a pixel, in rows of `wide`.
float sum_around(const float* pixel, Index wide) {
    const float *up = pixel - wide, *down = pixel + wide;
    return up[-1] + up[0] + up[1] + pixel[-1] + pixel[1] + down[-1] + down[0] + down[1];
}

// Gives unknown pixels of a row the mean of their known neighbours, without a branch: several at once; returns the
// number of those that have any.
std::int32_t fill_row(const float* height, const float* known, Index size, float* out_height, float* out_known) {
    std::array<float, most_pixels> heights, knowns;  // for the compiler to see that they are memory of their own
    std::int32_t filled = 0;
    for (Index q = 0; q < size; ++q) {
        const float total = sum_around(height + q, size + 2), count = sum_around(known + q, size + 2);
        const bool fills = (known[q] == 0.0F) & (count > 0.0F);
        const float mean = total / count, own = height[q];
        heights[static_cast<std::size_t>(q)] = fills ? mean : own;
        knowns[static_cast<std::size_t>(q)] = fills ? 1.0F : known[q];
        filled += fills ? 1 : 0;
    }
    std::copy_n(heights.begin(), size, out_height);
    std::copy_n(knowns.begin(), size, out_known);
    return filled;
}

// Writes the mean height of every pixel, and into empty ones, from the rim inwards, the mean of their known neighbours;
// returns the share of pixels with points.
double fill_heights(const PixelSums& sums, Array<float, 2> heights) {
    const Index size = heights.shape[0], wide = size + 2;
    const auto place = [wide](Index row, Index column) { return (row + 1) * wide + column + 1; };
    Padded image(wide * wide);
    Index held = 0;
    for (Index row = 0; row < size; ++row) {
        for (Index column = 0; column < size; ++column) {
            const Index k = row * size + column;
            if (!(sums.count[k] > 0.0)) continue;
            image.height[place(row, column)] = static_cast<float>(sums.sum[k] / sums.count[k]);
            image.known[place(row, column)] = 1.0F;
            ++held;
        }
    }
    Padded next = image;
    for (Index missing = held > 0 ? size * size - held : 0; missing > 0; std::swap(image, next)) {
        for (Index row = 0; row < size; ++row) {
            const Index p = place(row, 0);
            missing -= fill_row(&image.height[p], &image.known[p], size, &next.height[p], &next.known[p]);
        }
    }
    for (Index row = 0; row < size; ++row) std::copy_n(&image.height[place(row, 0)], size, heights.at(row).begin());
    return static_cast<double>(held) / static_cast<double>(size * size);
}

// Measures every sector that is listed.
void measure_sectors(CellPoints points, SectorInputs inputs, SectorMeasures out) {
    const Index pixels = out.heights.shape[1] * out.heights.shape[2];
    SectorPoints ground;
    for (Index s = 0; s < inputs.cells.size(); ++s) {
        const Index cell = inputs.cells[s];
        const Centre mean = centre_points(points, inputs.is_ground, cell, ground);
        const auto [principal, is_line] = principal_plane(ground.centred(), {}, infinite);
        out.normal(s, 0) = static_cast<float>(principal.a);
        out.normal(s, 1) = static_cast<float>(principal.b);
        out.normal(s, 2) = static_cast<float>(principal.c);
        const Plane plane = ransac_plane(ground.centred(), inputs.threshold, static_cast<std::uint64_t>(cell));
        const PixelSums sums = sum_by_pixel(ground, plane, pixels);
        out.scalars(s, 0) = mean.variance;
        out.scalars(s, 1) = plane.is_found() ? sums.residual : std::numeric_limits<double>::quiet_NaN();
        out.scalars(s, 2) = fill_heights(sums, out.heights.at(s));
        out.scalars(s, 3) = is_line ? mean.z : principal.a * mean.x + principal.b * mean.y + principal.c * mean.z;
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::SectorInputs, is_ground, cells, threshold)
BUMPY_RECORD(bumpy::SectorMeasures, scalars, normal, heights)

void bind_polar(nb::module_& module) {
    using namespace bumpy;
    BUMPY_LOOP(module, place_points);
    BUMPY_LOOP(module, measure_sectors);
}
