// Places the points of a scan on the polar grid, and measures its sectors: plane, spread and heightmap of each.
//
// Points are placed in blocks that stay in the nearest cache: first distance and direction of all, without a branch,
// then the cell of each; then they are listed by cell. A sector is measured in few passes through its ground points:
// their principal plane, a plane by RANSAC, and the mean height above it in every pixel. Sums are exact, so that the
// order of the points does not matter. Ours.
#include <array>
#include <utility>

#include "bumpymap/core/planes.hpp"
#include "surface.hpp"

namespace bumpy {
namespace {

// ---- The points by cell ----

// Points whose distance and direction are found at once.
constexpr Index block_points = 512;

struct Place {
    std::int32_t cell, pixel;
};

// Finds cells, by zone, ring and sector, and pixels.
class Placer {
  public:
    explicit Placer(const ZoneGrid& grid) : zones_(grid.sectors.size()), grid_(grid), scale_(zones_), first_(zones_) {
        Index home = 0;
        for (Index zone = 0; zone < zones_; ++zone) {
            scale_[zone] = static_cast<double>(grid.rings[zone]) / (grid.edges[zone + 1] - grid.edges[zone]);
            first_[zone] = home;
            home += grid.sectors[zone] * grid.rings[zone];
        }
    }

    // The place at a distance [m] and a turn from sector 0; -1 outside of the grid.
    Place at(double r, double turn) const {
        if (!(grid_.edges[0] <= r && r < grid_.edges[zones_])) return {-1, -1};
        Index zone = 0;
        while (r >= grid_.edges[zone + 1]) ++zone;
        const double outward = (r - grid_.edges[zone]) * scale_[zone];
        const double around = turn * static_cast<double>(grid_.sectors[zone]);
        const Index ring = std::min(static_cast<Index>(outward), grid_.rings[zone] - 1);
        const Index sector = std::min(static_cast<Index>(around), grid_.sectors[zone] - 1);
        const Index pixel = pixel_of(outward, ring) * grid_.pixels + pixel_of(around, sector);
        const Index cell = first_[zone] + ring * grid_.sectors[zone] + sector;
        return {static_cast<std::int32_t>(cell), static_cast<std::int32_t>(pixel)};
    }

  private:
    Index pixel_of(double place, Index whole) const {
        const double inside = (place - static_cast<double>(whole)) * static_cast<double>(grid_.pixels);
        return std::min(static_cast<Index>(inside), grid_.pixels - 1);
    }

    Index zones_;
    const ZoneGrid& grid_;
    Scratch<double> scale_;  // rings per metre
    Scratch<Index> first_;   // number of the first cell
};

// Finds the cell of every point, -1 outside of the grid, and its place in bins; and lists the points by cell.
void place_points(
    Array<const float, 2> points, ZoneGrid grid, Array<std::int32_t> cell, Array<std::uint16_t, 2> place,
    CellPoints out) {
    const Index size = points.shape[0];
    const BinRings rings(grid);
    const Placer placer(grid);
    struct PixelAndBin {
        std::int32_t pixel, bin;
    };
    thread_local Scratch<PixelAndBin> memory;
    Scratch<PixelAndBin>& places = memory;
    places.resize(static_cast<std::size_t>(size));
    std::array<double, block_points> x, y, away, turn;
    std::array<std::int32_t, block_points> ring, column;
    for (Index begin = 0; begin < size; begin += block_points) {
        const auto count = static_cast<std::size_t>(std::min(block_points, size - begin));
        const float* point = points.data + 3 * begin;
        for (std::size_t i = 0; i < count; ++i) {
            x[i] = point[3 * i];
            y[i] = point[3 * i + 1];
        }
        for (std::size_t i = 0; i < count; ++i) {
            const double square = x[i] * x[i] + y[i] * y[i], whole = full_turn(turn_of(x[i], y[i]));
            away[i] = std::sqrt(square);
            turn[i] = full_turn(whole - grid.start);
            ring[i] = rings.parts(square);
            column[i] = static_cast<std::int32_t>(whole * static_cast<double>(bin_columns * bin_parts));
        }
        for (std::size_t i = 0; i < count; ++i) {
            const Index p = begin + static_cast<Index>(i);
            const auto [home, pixel] = placer.at(away[i], turn[i]);
            cell[p] = home;
            const std::int32_t bin = ring[i] / bin_parts * static_cast<std::int32_t>(bin_columns);
            places[p] = {pixel, bin + column[i] / bin_parts};
            place(p, 0) = home < 0 ? no_place : static_cast<std::uint16_t>(ring[i]);
            place(p, 1) = static_cast<std::uint16_t>(column[i]);
            if (home >= 0) ++out.starts[home + 2];
        }
    }
    for (Index c = 2; c < out.starts.size(); ++c) out.starts[c] += out.starts[c - 1];
    for (Index p = 0; p < size; ++p) {
        if (cell[p] < 0) continue;
        const Index i = out.starts[cell[p] + 1]++;
        out.order[i] = static_cast<std::int32_t>(p);
        for (Index axis = 0; axis < 3; ++axis) out.xyz(axis, i) = points(p, axis);
        out.pixel[i] = places[p].pixel;
        out.bin[i] = places[p].bin;
    }
}

// ---- Planes of sectors ----

// Planes that RANSAC draws at most, and pixels that it scores them on.
constexpr Index most_candidates = 200;
constexpr std::size_t sample_pixels = 128;
// A plane whose upward normal is less than this (steeper than 78 degrees) is a wall: only the mean height comes off.
constexpr double steepest = 0.2;
// Product of the two horizontal spreads over the square of their sum: less is one scan line, bent as the sector is.
constexpr double line_spread = 2e-3;

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

// The ground points of a sector, minus their mean; and their means by pixel.
struct SectorPoints {
    Scratch<double> x, y, z;
    Scratch<std::int32_t> pixel;
    double mean_x = 0.0, mean_y = 0.0, mean_z = 0.0;
    Scratch<double> pixel_x, pixel_y, pixel_z;  // (pixels with points,) their means
    Scratch<std::int32_t> filled;               // (pixels with points,) which ones

    Index size() const { return x.count(); }
    CentredPoints<double> pixels() const {
        const std::array<Index, 1> shape{filled.count()};
        return {{pixel_x.data(), shape}, {pixel_y.data(), shape}, {pixel_z.data(), shape}};
    }

    void take(const CellPoints& points, Array<const bool> is_ground, Index cell, Index pixels) {
        for (auto* axis : {&x, &y, &z}) axis->clear();
        pixel.clear();
        std::array<double, 3> sums{};
        for (Index i = points.starts[cell]; i < points.starts[cell + 1]; ++i) {
            if (!is_ground[i]) continue;
            x.push_back(points.xyz(0, i));
            y.push_back(points.xyz(1, i));
            z.push_back(points.xyz(2, i));
            pixel.push_back(points.pixel[i]);
            sums[0] += exact(x.back());
            sums[1] += exact(y.back());
            sums[2] += exact(z.back());
        }
        const auto n = static_cast<double>(size());
        mean_x = sums[0] / n;
        mean_y = sums[1] / n;
        mean_z = sums[2] / n;
        struct Sum {
            double n = 0.0, x = 0.0, y = 0.0, z = 0.0;
        };
        Scratch<Sum> by_pixel(pixels);
        for (Index i = 0; i < size(); ++i) {
            Sum& sum = by_pixel[pixel[i]];
            sum.n += 1.0;
            sum.x += exact(x[i] -= mean_x);
            sum.y += exact(y[i] -= mean_y);
            sum.z += exact(z[i] -= mean_z);
        }
        for (auto* axis : {&pixel_x, &pixel_y, &pixel_z}) axis->clear();
        filled.clear();
        for (Index k = 0; k < pixels; ++k) {
            const Sum& sum = by_pixel[k];
            if (sum.n == 0.0) continue;
            filled.push_back(static_cast<std::int32_t>(k));
            pixel_x.push_back(sum.x / sum.n);
            pixel_y.push_back(sum.y / sum.n);
            pixel_z.push_back(sum.z / sum.n);
        }
    }
};

struct PrincipalPlane {
    Plane plane;
    bool is_line = false;   // whether the points lie on one line, seen from above
    double variance = 0.0;  // of their z, m^2
};

// The plane of the least perpendicular spread of the points within `reach` of a plane; none if there are too few.
PrincipalPlane principal_plane(const SectorPoints& points, Plane near, double reach) {
    constexpr std::size_t lanes = 4;  // points at once: their sums are exact, in any order
    std::array<std::array<double, lanes>, 10> sums{};
    const auto size = static_cast<std::size_t>(points.size());
    const double *x = points.x.data(), *y = points.y.data(), *z = points.z.data();
    const auto add = [&](std::size_t first, std::size_t lane) {
        const double u = x[first + lane], v = y[first + lane], w = z[first + lane];
        const std::array<double, 10> terms{1.0, u, v, w, u * u, u * v, u * w, v * v, v * w, w * w};
        const double counts = std::abs(near.above(u, v, w)) <= reach ? 1.0 : 0.0;
        for (std::size_t m = 0; m < terms.size(); ++m) sums[m][lane] += counts * exact(terms[m]);
    };
    std::size_t i = 0;
    for (; i + lanes <= size; i += lanes)
        for (std::size_t lane = 0; lane < lanes; ++lane) add(i, lane);
    for (; i < size; ++i) add(i, 0);
    std::array<double, 10> total{};
    for (std::size_t m = 0; m < total.size(); ++m)
        for (const double part : sums[m]) total[m] += part;
    const auto [n, sx, sy, sz, xx, xy, xz, yy, yz, zz] = total;
    if (n < 3.0) return {};
    const double mx = sx / n, my = sy / n, mz = sz / n;
    const auto [a, b, c] =
        least_axis({xx - sx * mx, xy - sx * my, xz - sx * mz, yy - sy * my, yz - sy * mz, zz - sz * mz});
    const bool is_line = xx * yy - xy * xy < line_spread * (xx + yy) * (xx + yy);
    return {{a, b, c, -(a * mx + b * my + c * mz)}, is_line, std::max(zz / n - mz * mz, 0.0)};
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

// The plane through three pixels that has the most of a sample of them within `threshold` [m]; none where none has any.
// Single precision is enough to count: coordinates start amid the points, so it errs by 1e-7 of the sector's side.
Plane best_candidate(const CentredPoints<double>& pixels, double threshold, std::uint64_t seed) {
    std::array<float, sample_pixels> x, y, z;
    const auto size = static_cast<std::size_t>(std::min(pixels.size(), Index{sample_pixels}));
    for (std::size_t p = 0; p < size; ++p) {  // in equal steps
        const Index k = static_cast<Index>(p) * pixels.size() / static_cast<Index>(size);
        x[p] = static_cast<float>(pixels.x[k]);
        y[p] = static_cast<float>(pixels.y[k]);
        z[p] = static_cast<float>(pixels.z[k]);
    }
    const auto reach = static_cast<float>(threshold);
    Plane best;
    std::int32_t most = 0;
    Index needed = most_candidates;
    for (Index drawn = 0; drawn < needed; ++drawn) {
        const auto [i, j, k] = three_below(next_random(seed), static_cast<std::uint64_t>(pixels.size()));
        const Plane plane = plane_through(pixels, i, j, k);
        if (!plane.is_found()) continue;
        const auto a = static_cast<float>(plane.a), b = static_cast<float>(plane.b), c = static_cast<float>(plane.c);
        const auto d = static_cast<float>(plane.d);
        std::int32_t hits = 0;
        for (std::size_t p = 0; p < size; ++p) hits += std::abs(a * x[p] + b * y[p] + c * z[p] + d) <= reach;
        if (hits <= most) continue;
        most = hits;
        best = plane;
        const double share = static_cast<double>(hits) / static_cast<double>(size);
        const double clean = share * share * share;  // chance that all three of a draw are inliers
        if (clean >= 1.0 - 1e-9) break;
        needed = draws_needed(clean, most_candidates);
    }
    return best;
}

// The plane by RANSAC (Fischler and Bolles 1981) through pixels, then twice the principal plane of the points near it;
// none where the points span none.
Plane ransac_plane(const SectorPoints& points, double threshold, std::uint64_t seed) {
    Plane plane = best_candidate(points.pixels(), threshold, seed);
    const double reach = plane.is_found() ? threshold : infinite;
    for (int round = 0; round < 2; ++round) {
        const Plane fitted = principal_plane(points, plane, reach).plane;
        if (!fitted.is_found()) break;
        plane = fitted;
    }
    return plane;
}

// ---- Measures of sectors ----

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

// Writes the mean height over a plane of every pixel, and into empty ones, from the rim inwards, the mean of their
// known neighbours; returns the share of pixels with points.
double fill_heights(const SectorPoints& points, Plane plane, Array<float, 2> heights) {
    const Index size = heights.shape[0], wide = size + 2, held = points.filled.count();
    const auto place = [wide](Index row, Index column) { return (row + 1) * wide + column + 1; };
    const auto [a, b, c, d] = plane;
    const bool is_wall = !(c > steepest);
    const double east = is_wall ? 0.0 : -a / c, north = is_wall ? 0.0 : -b / c, level = is_wall ? 0.0 : -d / c;
    Padded image(wide * wide);
    for (Index k = 0; k < held; ++k) {
        const Index p = place(points.filled[k] / size, points.filled[k] % size);
        const double over = points.pixel_z[k] - east * points.pixel_x[k] - north * points.pixel_y[k] - level;
        image.height[p] = static_cast<float>(over);
        image.known[p] = 1.0F;
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

// Measures the sectors of some cells by their ground points, `is_ground` (points,) by cell. Writes into `scalars`
// (sectors, 6) variance of z [m^2], residual [m] (NaN where the points span no plane), coverage, distance of the origin
// below the principal plane [m] (below the points' mean, where they lie on one line: they tell no tilt), slope along x
// and y of the plane that RANSAC found (0 where it is a wall); `normal` (sectors, 3) of the principal plane, zeros
// where the points lie on a line; `heights` (sectors, pixels, pixels) mean z above the plane that RANSAC found, holes
// filled, m.
void measure_sectors(
    CellPoints points, Array<const bool> is_ground, Array<const Index> cells, double threshold,
    Array<double, 2> scalars, Array<float, 2> normal, Array<float, 3> heights) {
    const Index pixels = heights.shape[1] * heights.shape[2];
    SectorPoints ground;
    for (Index s = 0; s < cells.size(); ++s) {
        const Index cell = cells[s];
        ground.take(points, is_ground, cell, pixels);
        const auto [principal, is_line, variance] = principal_plane(ground, {}, infinite);
        normal(s, 0) = static_cast<float>(principal.a);
        normal(s, 1) = static_cast<float>(principal.b);
        normal(s, 2) = static_cast<float>(principal.c);
        const Plane plane = ransac_plane(ground, threshold, static_cast<std::uint64_t>(cell));
        double residual = 0.0;
        for (Index i = 0; i < ground.size(); ++i)
            residual += exact(std::abs(plane.above(ground.x[i], ground.y[i], ground.z[i])));
        scalars(s, 0) = variance;
        scalars(s, 1) =
            plane.is_found() ? residual / static_cast<double>(ground.size()) : std::numeric_limits<double>::quiet_NaN();
        scalars(s, 2) = fill_heights(ground, plane, heights.at(s));
        const double mx = ground.mean_x, my = ground.mean_y, mz = ground.mean_z;
        scalars(s, 3) = is_line ? mz : principal.a * mx + principal.b * my + principal.c * mz;
        const bool is_wall = !(plane.c > steepest);
        scalars(s, 4) = is_wall ? 0.0 : -plane.a / plane.c;
        scalars(s, 5) = is_wall ? 0.0 : -plane.b / plane.c;
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_LOOPS(polar, place_points, measure_sectors)
