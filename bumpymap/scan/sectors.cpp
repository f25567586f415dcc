// Finds the ground of a scan and the objects on it, measures the sectors of the polar grid, and finds where the ground
// drops.
//
// Every point is placed once, in blocks that stay in the nearest cache: its cell and pixel on the grid, and its small
// bin around the sensor; then points lie side by side by cell. The surface of the ground (surface.cpp) and the plants
// in the bins say which points are ground. A sector is measured in few passes through its points. What lies behind an
// edge is not seen: so the ground is followed outwards, and if what is seen next lies too far below where it should go
// on, there is an edge in between. Sums are exact, so that the order of the points does not matter. Ours.
#include "surface.hpp"

namespace bumpy {
namespace {

// The settings of the grid and of the vehicle, as in `PolarSettings`.
struct ScanRule {
    Index pixels, least_points;
    double least_normal_z, overhead_m, belly_m, height_m;
};

// Sectors with enough points, one row each in the order of cells, as in `SectorStack`; there is room for a row more
// than cells.
struct SectorRows {
    Array<std::int16_t> zone, ring, sector;
    Array<std::int32_t> count, ground_count, obstacle_count, overhead_count;
    Array<bool> traversable, drop;
    Array<float, 2> normal;
    Array<float, 3> heights;
    Array<float> coverage, variance, residual, obstacle_height, clearance;
    Array<float, 4> objects;
    Array<double, 2> measures;
};

// Of the points of the scan, and of its bins, as in `SectorStack`.
struct PointRows {
    Array<std::uint16_t, 2> point_place;
    Array<std::int32_t> point_sector;
    Array<bool> point_ground, point_airborne;
    Array<float> point_height;
    Array<float, 2> places;
    Array<double> origin_height;  // (1,)
};

// Sums over the points of a bin: number, sum and squares of the heights of those near the surface, and later of its
// ground points; number of those that show plants; of other points below the belly, up to the vehicle's height, and
// above.
enum BinSum : std::size_t { near, sum, squares, rising, low, standing, over, bin_sums };
using BinSums = std::array<double, bin_sums>;

// The pull of the ground around a sector at its plane: the number of points at the sensor that would lie on it, and
// their spread, m^2. On one scan line this decides how the ground leans across it (chosen).
constexpr double plane_pull = 1e-3, slope_pull = 0.1;

// Ground points of a cell, or their means by pixel: place, and height over the ground around the cell, m.
struct GroundPoints {
    Scratch<double> x, y, h;
    Scratch<std::int32_t> pixel;

    void clear() {
        for (auto* values : {&x, &y, &h}) values->clear();
        pixel.clear();
    }
    void add(double east, double north, double height, std::int32_t of) {
        x.push_back(east);
        y.push_back(north);
        h.push_back(height);
        pixel.push_back(of);
    }
    // The plane of those within `reach` of a plane, m.
    Tilt fit(Tilt near, double reach) const {
        Sums sums;
        for (Index i = 0; i < x.count(); ++i)
            sums.add(std::abs(near.above(x[i], y[i], h[i])) < reach ? 1.0 : 0.0, x[i], y[i], h[i]);
        return sums.solve(plane_pull, slope_pull);
    }
};

// An image with a margin of a pixel, where all neighbours exist.
struct Padded {
    Scratch<float> height, known;  // known: 1 or 0; unknown heights are 0
};

// A heightmap in work.
struct HeightImage {
    Scratch<std::array<double, 4>> sums;  // (pixels^2,) number of the points, and sums of x, y and height, m
    GroundPoints means;                   // of pixels with points
    Padded image, next;
};

// A frame on its way through the loop: memory that is kept from scan to scan.
struct Frame {
    Scratch<std::int32_t> cell;                          // (scan's points,) -1 outside of the grid
    Scratch<std::array<std::int32_t, 2>> pixel_and_bin;  // the same
    Scratch<Index> starts;      // (cells + 2,) cell c has the points from `starts[c]` to `starts[c + 1]`
    PlacedPoints points;        // by cell
    Scratch<float> height;      // (points,) over the surface, m
    Scratch<Tilt> planes;       // (bins,) that touch the surface
    Scratch<BinSums> sums;      // (bins,)
    Scratch<float> reach;       // (bins,) height up to which points are ground, m; below all where none are
    Scratch<Tilt> around, own;  // (cells,) the ground around their middles, and that of their points
    Scratch<std::array<float, 2>>
        lowest;           // (cells * pixels^2,) z of the lowest ground point and of the lowest other, m
    GroundPoints ground;  // of the cell that is measured
    Scratch<float> feet;  // (pixels^2,) height of the lowest object in each, m
    HeightImage image;
};

// ---- The points by cell ----

// Points whose distance and direction are found at once.
constexpr Index block_points = 512;

// Finds cells, by zone, ring and sector, and pixels.
class Placer {
  public:
    Placer(const ZoneGrid& grid, Index pixels)
        : zones_(grid.sectors.size()), pixels_(pixels), grid_(grid), scale_(zones_), first_(zones_ + 1) {
        for (Index zone = 0; zone < zones_; ++zone) {
            scale_[zone] = static_cast<double>(grid.rings[zone]) / (grid.edges[zone + 1] - grid.edges[zone]);
            first_[zone + 1] = first_[zone] + grid.sectors[zone] * grid.rings[zone];
        }
    }

    Index cells() const { return first_[zones_]; }

    // The cell and the pixel at a distance [m] and a turn from sector 0; -1 outside of the grid.
    std::array<std::int32_t, 2> at(double r, double turn) const {
        if (!(grid_.edges[0] <= r && r < grid_.edges[zones_])) return {-1, -1};
        Index zone = 0;
        while (r >= grid_.edges[zone + 1]) ++zone;
        const double outward = (r - grid_.edges[zone]) * scale_[zone];
        const double around = turn * static_cast<double>(grid_.sectors[zone]);
        const Index ring = std::min(static_cast<Index>(outward), grid_.rings[zone] - 1);
        const Index sector = std::min(static_cast<Index>(around), grid_.sectors[zone] - 1);
        const Index pixel = pixel_of(outward, ring) * pixels_ + pixel_of(around, sector);
        return {
            static_cast<std::int32_t>(first_[zone] + ring * grid_.sectors[zone] + sector),
            static_cast<std::int32_t>(pixel)};
    }

  private:
    Index pixel_of(double place, Index whole) const {
        const double inside = (place - static_cast<double>(whole)) * static_cast<double>(pixels_);
        return std::min(static_cast<Index>(inside), pixels_ - 1);
    }

    Index zones_, pixels_;
    const ZoneGrid& grid_;
    Scratch<double> scale_;  // rings per metre
    Scratch<Index> first_;   // number of the first cell
};

// Finds the cell of every point and its place in bins, and lists the points by cell.
void place_points(
    Array<const float, 2> points, const ZoneGrid& grid, const Placer& placer, const BinRings& rings,
    Array<std::uint16_t, 2> place, Frame& s) {
    const Index size = points.shape[0];
    s.pixel_and_bin.resize(static_cast<std::size_t>(size));
    s.cell.resize(static_cast<std::size_t>(size));
    renew(s.starts, placer.cells() + 2);
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
            const std::int32_t bin = ring[i] / bin_parts * static_cast<std::int32_t>(bin_columns);
            s.cell[p] = home;
            s.pixel_and_bin[p] = {pixel, bin + column[i] / bin_parts};
            place(p, 0) = home < 0 ? no_place : static_cast<std::uint16_t>(ring[i]);
            place(p, 1) = static_cast<std::uint16_t>(column[i]);
            if (home >= 0) ++s.starts[home + 2];
        }
    }
    for (Index c = 2; c < s.starts.count(); ++c) s.starts[c] += s.starts[c - 1];
    s.points.resize(static_cast<std::size_t>(s.starts.back()));
    for (Index p = 0; p < size; ++p) {
        if (s.cell[p] < 0) continue;
        const auto [pixel, bin] = s.pixel_and_bin[p];
        s.points[s.starts[s.cell[p] + 1]++] = {points(p, 0), points(p, 1), points(p, 2), static_cast<std::int32_t>(p),
                                               pixel,        bin};
    }
}

// ---- The points on the ground ----

// A point is ground between these heights over the surface, m: below, and this multiple of the noise of the ground
// above, with limits.
constexpr float below_surface = -0.5F;
constexpr double reach_of_noise = 10.0, least_reach = 0.15, most_reach = 0.25;
// The noise is the spread of the points up to this height over the surface, m, in bins that have this number of them:
// the median over the bins of an octave that has this number of those. Where none has, it is this, m.
constexpr float near_surface = 0.2F;
constexpr double least_points = 5.0, usual_noise = 0.03;
constexpr Index least_bins = 16;
// Plants stand in a bin and those around it if between `near_surface` and this height, m, there are points, as a share
// of those near the surface, and those spread in their bins by more than this multiple of the noise and this, m. They
// stand in the bin itself if it has at least this share of such points, or spreads so.
constexpr float plants_top = 0.95F;
constexpr double plants_share = 0.5, own_share = 0.1, plants_spread = 1.6, plants_least = 0.043;
// Slope of 38 degrees: tan(radians(38)). What is steeper is no ground.
const double steepest = std::tan(38.0 * (std::numbers::pi / 180.0));
// Ground that is higher than this above the origin, m, must have objects on it that are higher than this, m, and more
// of them than hang below it: a frame may have its origin below the robot, or z may point down.
constexpr double highest = 0.5;
constexpr float stands = 0.5F;

// Sum of the squares of the heights near the surface about their mean.
double scatter_of(const BinSums& bin) {
    return bin[near] > 0.0 ? std::max(bin[squares] - bin[sum] * bin[sum] / bin[near], 0.0) : 0.0;
}

// Finds the heights of all points; returns whether the frame hangs from what looks like ground.
bool find_heights(const Surface& surface, const BinRings& rings, Frame& s) {
    renew(s.planes, rings.count * bin_columns);
    renew(s.sums, s.planes.count());
    s.height.resize(s.points.size());
    const Layers& layers = surface.layers;
    for (Index i = 0; i < layers.size(); ++i) {
        const auto [ring, column] = layers.middle(i);
        s.planes[layers.bin[i]] = surface.levels.back().at(ring, column);
    }
    Index higher = 0, lower = 0;
    for (Index i = 0; i < s.points.count(); ++i) {
        const PlacedPoint& p = s.points[i];
        const auto h = static_cast<float>(s.planes[p.bin].above(p.x, p.y, p.z));
        s.height[i] = h;
        higher += h > stands;
        lower += h < -stands;
        BinSums& bin = s.sums[p.bin];
        if (below_surface < h && h < near_surface) {
            bin[near] += 1.0;
            bin[sum] += exact(h);
            bin[squares] += exact(static_cast<double>(h) * h);
        } else if (h >= near_surface && h < plants_top) {
            bin[rising] += 1.0;
        }
    }
    return surface.whole.c > highest && higher <= lower;
}

// The noise of the ground in every ring, m: between the medians of octaves.
Scratch<double> find_noise(const Scratch<BinSums>& bins, const BinRings& rings) {
    Scratch<double> out(rings.count, usual_noise), spreads;
    double before = -1.0, last = usual_noise;
    for (Index begin = 0; begin < rings.count; begin += octave_rings) {
        spreads.clear();
        const Index end = std::min(begin + octave_rings, rings.count) * bin_columns;
        for (Index bin = begin * bin_columns; bin < end; ++bin)
            if (bins[bin][near] >= least_points) spreads.push_back(std::sqrt(scatter_of(bins[bin]) / bins[bin][near]));
        if (spreads.count() < least_bins) continue;
        const auto middle = spreads.begin() + spreads.count() / 2;
        std::nth_element(spreads.begin(), middle, spreads.end());
        const double here = static_cast<double>(begin) + 0.5 * octave_rings;
        for (Index ring = 0; ring < rings.count; ++ring) {
            const auto at = static_cast<double>(ring);
            if (at < before) continue;
            const double share = before < 0.0 ? 1.0 : std::min((at - before) / (here - before), 1.0);
            out[ring] = last + share * (*middle - last);
        }
        before = here;
        last = *middle;
    }
    return out;
}

// Finds up to which height the points of each bin are ground: none in steep bins, and in those in which plants rise.
void find_reaches(const BinRings& rings, Frame& s) {
    struct Spread {
        double count, rising, scatter;
    };
    const Scratch<double> noise = find_noise(s.sums, rings);
    Scratch<Spread> spreads;
    spreads.reserve(s.sums.size());
    for (const BinSums& bin : s.sums) spreads.push_back({bin[near], bin[rising], scatter_of(bin)});
    s.reach.resize(s.sums.size());
    for (Index bin = 0; bin < s.sums.count(); ++bin) {
        const Spread& own = spreads[bin];
        const Index ring = bin / bin_columns;
        const auto [a, b, c] = s.planes[bin];
        s.reach[bin] = static_cast<float>(std::clamp(reach_of_noise * noise[ring], least_reach, most_reach));
        if (a * a + b * b > steepest * steepest) s.reach[bin] = below_surface;
        if (own.count == 0.0) continue;
        const double plants = std::max(plants_spread * noise[ring], plants_least);
        const auto spread = [](const Spread& of, double least) { return of.scatter > least * least * of.count; };
        if (own.rising < own_share * own.count && !spread(own, plants)) continue;
        Spread all = own;
        around_bin(bin, 1, rings.count, [&](Index other) {
            all.count += spreads[other].count;
            all.rising += spreads[other].rising;
            all.scatter += spreads[other].scatter;
            return true;
        });
        if (all.rising >= plants_share * all.count && spread(all, plants)) s.reach[bin] = below_surface;
    }
}

// ---- Measures of places ----

// The spread of the ground, m, where there is none, and the number of points that it has there.
constexpr double usual_spread = 0.03, usual_points = 0.5;
constexpr std::size_t place_measures = 7;

// Adds to every bin half of those beside it, outwards and around; the sum of the weights is one.
template <class Values>
void smooth(Scratch<Values>& places) {
    const Index rings = places.count() / bin_columns;
    std::array<Values, bin_columns + 2> row;  // a bin at each end stands for the one at the other
    const Scratch<Values> before = places;
    const Values nothing{};
    for (Index ring = 0; ring < rings; ++ring) {
        for (Index column = 0; column < bin_columns; ++column) {
            const Index bin = ring * bin_columns + column;
            const Values& inner = ring > 0 ? before[bin - bin_columns] : nothing;
            const Values& outer = ring + 1 < rings ? before[bin + bin_columns] : nothing;
            Values& out = row[static_cast<std::size_t>(column + 1)];
            for (std::size_t k = 0; k < nothing.size(); ++k)
                out[k] = 0.5 * before[bin][k] + 0.25 * (inner[k] + outer[k]);
        }
        row.front() = row[bin_columns];
        row.back() = row[1];
        for (std::size_t column = 1; column <= bin_columns; ++column)
            for (std::size_t k = 0; k < nothing.size(); ++k)
                places[ring * bin_columns + static_cast<Index>(column) - 1][k] =
                    0.5 * row[column][k] + 0.25 * (row[column - 1][k] + row[column + 1][k]);
    }
}

// Nearly the logarithm to base 2, see `BinRings`.
double about_log2(double x) { return BinRings::bits(x) / static_cast<double>(1 << 23) - 127.0; }

// Writes the measures of every bin, smoothed over those around it: shares of the points, as roots where they are few,
// the spread of the ground, the number of points, the distance; last, and not one of them, the ground points about it.
void measure_places(const ScanRule& rule, Frame& s, Array<float, 2> out) {
    const auto belly = static_cast<float>(rule.belly_m), height = static_cast<float>(rule.height_m);
    renew(s.sums, s.sums.count());
    for (Index i = 0; i < s.points.count(); ++i) {
        const Index b = s.points[i].bin;
        BinSums& bin = s.sums[b];
        const float h = s.height[i];
        if (below_surface < h && h < s.reach[b]) {
            bin[near] += 1.0;
            bin[sum] += exact(h);
            bin[squares] += exact(static_cast<double>(h) * h);
        } else {
            bin[h <= belly ? low : h < height ? standing : over] += 1.0;
        }
    }
    smooth(s.sums);
    Scratch<std::array<double, 1>> ground_about(s.sums.count());
    for (Index bin = 0; bin < s.sums.count(); ++bin) {
        const BinSums& of = s.sums[bin];
        const double ground = of[near], all = ground + of[low] + of[standing] + of[over] + 1e-3;
        const double variance =
            (scatter_of(of) + usual_points * usual_spread * usual_spread) / (ground + usual_points) + 1e-6;
        const std::array<double, place_measures> measures{
            std::sqrt(of[low] / all),
            std::sqrt(of[standing] / all),
            std::sqrt(of[over] / all),
            ground / all,
            0.15 * about_log2(variance),
            0.3 * about_log2(all),
            0.3 * static_cast<double>(bin / bin_columns) / octave_rings};
        for (std::size_t k = 0; k < place_measures; ++k)
            out(bin, static_cast<Index>(k)) = static_cast<float>(measures[k]);
        ground_about[bin][0] = ground;
    }
    smooth(ground_about);
    for (Index bin = 0; bin < out.shape[0]; ++bin) out(bin, place_measures) = static_cast<float>(ground_about[bin][0]);
}

// ---- The ground of sectors ----

// Fewest ground points of a sector that has ground (chosen).
constexpr Index least_ground = 10;
// A sector's plane is that of the means by pixel of its ground, then twice that of those nearer to it than this, m.
constexpr double near_plane = 0.1;
// Most pixels along a side of a heightmap, as `PolarSettings` allows.
constexpr std::size_t most_pixels = 64;

// Gives unknown pixels of a row the mean of their known neighbours, without a branch: several at once; returns the
// number of those that have any. All begin at the margin.
std::int32_t fill_row(const float* height, const float* known, Index size, float* out_height, float* out_known) {
    const auto wide = static_cast<std::ptrdiff_t>(size + 2);
    std::array<float, most_pixels + 2> heights, knowns;  // sums of three pixels outwards
    for (std::ptrdiff_t q = 0; q < wide; ++q) {
        const auto k = static_cast<std::size_t>(q);
        heights[k] = height[q - wide] + height[q] + height[q + wide];
        knowns[k] = known[q - wide] + known[q] + known[q + wide];
    }
    std::int32_t filled = 0;
    for (std::size_t q = 1; q <= static_cast<std::size_t>(size); ++q) {
        const float total = heights[q - 1] + heights[q] + heights[q + 1];
        const float count = knowns[q - 1] + knowns[q] + knowns[q + 1];
        const bool fills = (known[q] == 0.0F) & (count > 0.0F);
        out_height[q] = fills ? total / count : height[q];
        out_known[q] = fills ? 1.0F : known[q];
        filled += fills ? 1 : 0;
    }
    return filled;
}

// Finds the means of the ground points by pixel.
void find_means(const GroundPoints& ground, Index pixels, HeightImage& s) {
    renew(s.sums, pixels);
    s.means.clear();
    for (Index i = 0; i < ground.x.count(); ++i) {
        auto& [count, x, y, h] = s.sums[ground.pixel[i]];
        count += 1.0;
        x += exact(ground.x[i]);
        y += exact(ground.y[i]);
        h += exact(ground.h[i]);
    }
    for (Index k = 0; k < pixels; ++k) {
        const auto [count, x, y, h] = s.sums[k];
        if (count > 0.0) s.means.add(x / count, y / count, h / count, static_cast<std::int32_t>(k));
    }
}

// Writes the mean height over a plane of every pixel, and into empty ones, from the rim inwards, the mean of their
// known neighbours.
void fill_heights(Tilt plane, Array<float, 2> heights, HeightImage& s) {
    const Index size = heights.shape[0], wide = size + 2, held = s.means.x.count();
    auto& [sums, means, image, next] = s;
    for (auto* values : {&image.height, &image.known}) renew(*values, wide * wide);
    for (Index k = 0; k < held; ++k) {
        const Index p = (means.pixel[k] / size + 1) * wide + means.pixel[k] % size + 1;
        image.height[p] = static_cast<float>(plane.above(means.x[k], means.y[k], means.h[k]));
        image.known[p] = 1.0F;
    }
    next = image;
    for (Index missing = size * size - held; missing > 0; std::swap(image, next)) {
        for (Index row = 0; row < size; ++row) {
            const Index p = (row + 1) * wide;
            missing -= fill_row(&image.height[p], &image.known[p], size, &next.height[p], &next.known[p]);
        }
    }
    for (Index row = 0; row < size; ++row)
        std::copy_n(&image.height[(row + 1) * wide + 1], size, heights.at(row).begin());
}

// Measures the ground of a sector: normal, spread, heightmap; returns its plane. `around`: the ground around it;
// `whole`: that of the scan.
Tilt measure_ground(
    const GroundPoints& ground, Tilt around, Tilt whole, const ScanRule& rule, Index row, const SectorRows& out,
    HeightImage& image) {
    const Index size = ground.x.count();
    const auto count = static_cast<double>(size);
    find_means(ground, rule.pixels * rule.pixels, image);
    const GroundPoints& means = image.means;
    const Tilt all = ground.fit({}, infinite),
               plane = means.fit(means.fit(means.fit({}, infinite), near_plane), near_plane);
    const double a = around.a + all.a, b = around.b + all.b, upward = 1.0 / std::sqrt(a * a + b * b + 1.0);
    out.normal(row, 0) = static_cast<float>(-a * upward);
    out.normal(row, 1) = static_cast<float>(-b * upward);
    out.normal(row, 2) = static_cast<float>(upward);
    const double over = all.c + around.c - std::max(whole.c, 0.0);
    out.traversable[row] = upward >= rule.least_normal_z && over <= rule.overhead_m;
    double total = 0.0, square = 0.0, residual = 0.0;
    for (Index i = 0; i < size; ++i) {
        const double z = ground.h[i] + around.a * ground.x[i] + around.b * ground.y[i];
        total += exact(z);
        square += exact(z * z);
        residual += exact(std::abs(plane.above(ground.x[i], ground.y[i], ground.h[i])));
    }
    const double east = around.a + plane.a, north = around.b + plane.b;
    out.variance[row] = static_cast<float>(std::max(square / count - (total / count) * (total / count), 0.0));
    out.residual[row] = static_cast<float>(residual / count / std::sqrt(east * east + north * north + 1.0));
    fill_heights(plane, out.heights.at(row), image);
    out.coverage[row] = static_cast<float>(means.x.count()) / static_cast<float>(rule.pixels * rule.pixels);
    out.ground_count[row] = static_cast<std::int32_t>(size);
    return {east, north, 0.0};
}

// ---- Objects ----

// Objects on the ground are drawn up to this multiple of the vehicle's height.
constexpr float objects_height = 2.0F;
// Returns in pixels next to each other lie together if their heights are so near to each other, m, at the sensor, and
// more for each metre from it; this number is an object.
constexpr double beside_m = 0.03, beside_per_metre = 0.04;
constexpr float together = 3.0F;
// Fewest points that are an obstacle: a single one may be an error.
constexpr std::int32_t least_obstacle = 2;

// The points above ground in the pixels of a cell, up to `objects_height`: highest, lowest [m], and number.
struct Objects {
    Array<float> top, count, lowest;
};

// Takes returns that lie alone from the objects of a cell: fewer than three in a pixel and those next to it. The beams
// on an object lie side by side, so that its returns do; those from rain, dust or an insect lie alone.
void leave_out_airborne(const Objects& objects, double reach, Index side) {
    const auto& [top, count, lowest] = objects;
    for (Index place = 0; place < top.size(); ++place) {
        if (!(0.0F < count[place] && count[place] < together)) continue;
        const double low = lowest[place] - reach, high = top[place] + reach;
        float beside = high - low < 3.0 * reach ? count[place] : 1.0F;
        const Index row = place / side, column = place % side;
        for (Index r = std::max(row - 1, Index{0}); r < std::min(row + 2, side); ++r) {
            for (Index c = std::max(column - 1, Index{0}); c < std::min(column + 2, side); ++c) {
                const Index k = r * side + c;
                const bool touches = lowest[k] < high && top[k] > low;
                if (k != place && count[k] != 0.0F && touches) beside += std::abs(count[k]);
            }
        }
        if (beside < together) count[place] = -count[place];
    }
    for (Index place = 0; place < top.size(); ++place)
        if (count[place] < 0.0F) top[place] = count[place] = 0.0F;
}

// Finds the ground points of a cell at a distance, m, and the objects on it and over it, and measures them into a row.
void measure_cell(
    Index cell, double away, Tilt whole, const ScanRule& rule, Index row, const SectorRows& out, const PointRows& of,
    Frame& s) {
    GroundPoints& ground = s.ground;
    ground.clear();
    const Index pixels = rule.pixels * rule.pixels, begin = s.starts[cell], end = s.starts[cell + 1];
    const Array<float, 3> drawn = out.objects.at(row);
    std::fill_n(drawn.data, drawn.count(), 0.0F);
    s.feet.resize(static_cast<std::size_t>(pixels));
    const Objects objects{{drawn.data, {pixels}}, {drawn.data + pixels, {pixels}}, {s.feet.data(), {pixels}}};
    const auto belly = static_cast<float>(rule.belly_m), height = static_cast<float>(rule.height_m);
    const float top = objects_height * height;
    const Tilt around = s.around[cell];
    std::array<double, place_measures + 1> measures{};  // the ground points too: eight are as fast as seven
    std::int32_t overhead = 0, obstacles = 0;
    float clearance = std::numeric_limits<float>::infinity(), highest_obstacle = 0.0F;
    bool has_objects = false;
    for (Index i = begin; i < end; ++i) {
        const auto [x, y, z, number, pixel, bin] = s.points[i];
        const float h = s.height[i];
        const bool is_ground = below_surface < h && h < s.reach[bin];
        of.point_height[number] = h;
        of.point_ground[number] = is_ground;
        float& deepest = s.lowest[cell * pixels + pixel][is_ground ? 0 : 1];
        deepest = std::min(deepest, z);
        const float* place = &of.places(bin, 0);
        for (std::size_t k = 0; k < measures.size(); ++k) measures[k] += exact(place[k]);
        if (is_ground) {
            ground.add(x, y, around.above(x, y, z), pixel);
            continue;
        }
        if (h >= height) {
            ++overhead;
            clearance = std::min(clearance, h);
        }
        if (0.0F < h && h < top) {
            float& foot = objects.lowest[pixel];
            foot = objects.count[pixel] == 0.0F ? h : std::min(foot, h);
            objects.top[pixel] = std::max(objects.top[pixel], h);
            objects.count[pixel] += 1.0F;
            has_objects = true;
        }
    }
    if (has_objects) {
        leave_out_airborne(objects, beside_m + beside_per_metre * away, rule.pixels);
        for (Index i = begin; i < end; ++i) {
            const float h = s.height[i];
            const PlacedPoint& p = s.points[i];
            if (!(0.0F < h && h < top) || h < s.reach[p.bin]) continue;
            if (objects.count[p.pixel] == 0.0F) {
                of.point_airborne[p.number] = true;
            } else if (belly <= h && h < height) {
                ++obstacles;
                highest_obstacle = std::max(highest_obstacle, h);
            }
        }
    }
    const bool has_ground = ground.x.count() >= least_ground;
    const float unknown = std::numeric_limits<float>::quiet_NaN();
    out.count[row] = static_cast<std::int32_t>(end - begin);
    out.obstacle_count[row] = obstacles;
    out.overhead_count[row] = overhead;
    out.obstacle_height[row] = has_ground && obstacles >= least_obstacle ? highest_obstacle : unknown;
    out.clearance[row] = overhead > 0 ? clearance : unknown;
    for (Index k = 0; k < out.measures.shape[1]; ++k)
        out.measures(row, k) = measures[static_cast<std::size_t>(k)] / static_cast<double>(end - begin);
    if (has_ground) {
        s.own[cell] = measure_ground(ground, around, whole, rule, row, out, s.image);
        return;
    }
    std::fill_n(&out.normal(row, 0), 3, 0.0F);
    std::fill_n(&out.heights(row, 0, 0), pixels, 0.0F);
    out.traversable[row] = false;
    out.ground_count[row] = 0;
    out.coverage[row] = 0.0F;
    out.variance[row] = out.residual[row] = unknown;
}

// ---- Drops ----

// Directions in which the ground is followed, a degree apart, and share of those of a cell in which a drop is seen, at
// least (chosen).
constexpr Index drop_directions = 360;
constexpr double drop_share = 0.2;
// A drop is steeper than this, against the slope of the ground before it; hills are not. The view over an edge is as
// steep 15 m away from a sensor that is 1.2 m high, so edges farther away are not found.
constexpr double drop_slope = 0.08;
// Beams to what lies behind an edge pass above the ground before it, or less below it than this, m (chosen: an error):
// if not, the ground goes on, and what is seen below is a reflection in it. Where the origin is lower above the ground
// than this, m (chosen), it is not where the sensor is, and beams say nothing.
constexpr double beam_below = -0.1, sensor_height = 0.25;

// The way outwards in one direction, and the last ground on it.
struct GroundWay {
    double east, north;                    // the direction
    Index last = -1, marked = -1;          // cells: of the last ground, and behind the last drop; -1: none yet
    double r = 0.0, z = 0.0, slope = 0.0;  // of the last ground: distance, height [m] and slope

    double along(Tilt ground) const { return ground.a * east + ground.b * north; }

    // Counts a drop before a return of a cell at a distance and a height, m, if there is one. What lies below the
    // `whole` ground by less than half of `least` is a terrace.
    void reach(Index cell, double at, double height, double least, Tilt whole, Scratch<std::int32_t>& drops) {
        if (last < 0) return;
        const double way = at - r, level = along(whole);
        const double drop = z + slope * way - height, beam = height * r / at - z;
        if (!(drop > std::max(least, drop_slope * way) && (beam > beam_below || whole.c > -sensor_height))) return;
        if (!(z + level * way - height > 0.5 * least)) return;
        drops[last] += marked != last;
        drops[cell] += cell != last && cell != marked;
        marked = cell;
    }
};

// Counts the directions in which the ground drops by more than `least`, m, in every cell: for the last cell before a
// drop, and for that of what is seen below.
Scratch<std::int32_t> find_drops(const ZoneGrid& grid, Index pixels, double least, Tilt whole, const Frame& s) {
    Scratch<std::int32_t> drops(s.around.count());
    for (Index direction = 0; direction < drop_directions; ++direction) {
        const double share = (static_cast<double>(direction) + 0.5) / static_cast<double>(drop_directions);
        const double turn = 2.0 * std::numbers::pi * (share + grid.start);
        GroundWay way{std::cos(turn), std::sin(turn)};
        Index first = 0;
        for (Index zone = 0; zone < grid.sectors.size(); ++zone) {
            const Index rings = grid.rings[zone], sectors = grid.sectors[zone];
            const double around = share * static_cast<double>(sectors);
            const auto sector = static_cast<Index>(around);
            const auto column =
                static_cast<Index>((around - static_cast<double>(sector)) * static_cast<double>(pixels));
            const double width = (grid.edges[zone + 1] - grid.edges[zone]) / static_cast<double>(rings * pixels);
            for (Index ring = 0; ring < rings; ++ring) {
                const Index cell = first + ring * sectors + sector;
                if (s.starts[cell] == s.starts[cell + 1]) continue;
                for (Index row = 0; row < pixels; ++row) {
                    const auto [ground, other] = s.lowest[(cell * pixels + row) * pixels + column];
                    const bool is_ground = ground < infinite;
                    const double z = is_ground ? ground : other;
                    if (z == infinite) continue;
                    const double r = grid.edges[zone] + (static_cast<double>(ring * pixels + row) + 0.5) * width;
                    way.reach(cell, r, z, least, whole, drops);
                    if (!is_ground) continue;
                    way.last = cell;
                    way.r = r;
                    way.z = z;
                    way.slope = std::max(way.along(s.around[cell]), way.along(s.own[cell]));
                }
            }
            first += sectors * rings;
        }
    }
    return drops;
}

// Finds the ground of a scan, and measures the sectors with more than `least_points` points; returns their number.
// Points come without height and ground, and as not airborne.
Index find_sectors(Array<const float, 2> points, ZoneGrid grid, ScanRule rule, SectorRows out, PointRows of) {
    Frame& s = kept_memory<Frame>();
    const BinRings rings(grid);
    const Placer placer(grid, rule.pixels);
    place_points(points, grid, placer, rings, of.point_place, s);
    const Surface surface = find_surface(s.points, rings);
    const Level& wide = surface.levels.front();
    const bool hangs = find_heights(surface, rings, s);
    find_reaches(rings, s);
    if (hangs && rule.overhead_m < infinite) {
        std::fill(s.reach.begin(), s.reach.end(), below_surface);
        std::fill(s.height.begin(), s.height.end(), std::numeric_limits<float>::quiet_NaN());
        renew(s.sums, s.sums.count());
    }
    measure_places(rule, s, of.places);
    const Index cells = placer.cells(), pixels = rule.pixels * rule.pixels;
    for (auto* planes : {&s.around, &s.own}) planes->resize(static_cast<std::size_t>(cells));
    s.lowest.resize(static_cast<std::size_t>(cells * pixels));
    Scratch<std::int32_t> row_of(cells, -1);
    Index rows = 0, cell = 0;
    const auto measure = [&](Index zone, Index ring, Index sector) {
        const double width = (grid.edges[zone + 1] - grid.edges[zone]) / static_cast<double>(grid.rings[zone]);
        const double away = grid.edges[zone] + (static_cast<double>(ring) + 0.5) * width;
        const double turn = (static_cast<double>(sector) + 0.5) / static_cast<double>(grid.sectors[zone]) + grid.start;
        const double column = (turn - std::floor(turn)) * static_cast<double>(bin_columns);
        s.around[cell] = s.own[cell] = wide.at(rings.place(away * away), column);
        if (s.starts[cell] == s.starts[cell + 1]) return;
        const float nothing = std::numeric_limits<float>::infinity();
        std::fill_n(&s.lowest[cell * pixels], pixels, std::array{nothing, nothing});
        measure_cell(cell, away, surface.whole, rule, rows, out, of, s);
        if (s.starts[cell + 1] - s.starts[cell] <= rule.least_points) return;
        out.zone[rows] = static_cast<std::int16_t>(zone);
        out.ring[rows] = static_cast<std::int16_t>(ring);
        out.sector[rows] = static_cast<std::int16_t>(sector);
        row_of[cell] = static_cast<std::int32_t>(rows++);
    };
    for (Index zone = 0; zone < grid.sectors.size(); ++zone)
        for (Index ring = 0; ring < grid.rings[zone]; ++ring)
            for (Index sector = 0; sector < grid.sectors[zone]; ++sector, ++cell) measure(zone, ring, sector);
    const Scratch<std::int32_t> drops = find_drops(grid, rule.pixels, rule.belly_m, surface.whole, s);
    for (Index c = 0; c < cells; ++c) {
        const Index row = row_of[c];
        if (row < 0) continue;
        const double seen = static_cast<double>(drop_directions) / static_cast<double>(grid.sectors[out.zone[row]]);
        out.drop[row] = out.ground_count[row] > 0 && drops[c] >= drop_share * seen;
    }
    for (Index p = 0; p < points.shape[0]; ++p) of.point_sector[p] = s.cell[p] < 0 ? -1 : row_of[s.cell[p]];
    of.origin_height[0] = -wide.height_at_origin();
    return rows;
}

// Returns the number of bins of a grid.
Index count_bins(ZoneGrid grid) { return BinRings(grid).count * bin_columns; }

// Finds the classes at the places of points.
void find_classes(Array<const std::uint16_t, 2> place, ClassField field, Array<std::uint8_t> class_id) {
    for (Index i = 0; i < class_id.size(); ++i)
        class_id[i] = place(i, 0) == no_place ? field.unknown : field.at(place(i, 0), place(i, 1));
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::ScanRule, pixels, least_points, least_normal_z, overhead_m, belly_m, height_m)
BUMPY_RECORD(
    bumpy::SectorRows, zone, ring, sector, count, ground_count, obstacle_count, overhead_count, traversable, drop,
    normal, heights, coverage, variance, residual, obstacle_height, clearance, objects, measures)
BUMPY_RECORD(
    bumpy::PointRows, point_place, point_sector, point_ground, point_airborne, point_height, places, origin_height)

BUMPY_LOOPS(sectors, find_sectors, count_bins, find_classes)
