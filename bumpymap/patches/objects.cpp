// The points over the ground of tiles in, the state of each pixel out.
//
// A tile is taken by itself: its ground surface (known pixels, a plane and filled holes), the heights of the other
// points above it, and the rules of `find_objects` in features.py for what of that is an obstacle. Ours.
#include <array>
#include <numeric>

#include "bumpymap/core/pixel_states.hpp"
#include "bumpymap/patches/heightmap.hpp"
#include "bumpymap/patches/points_by_tile.hpp"

namespace bumpy {
namespace {

// ---- Strips: true if pulses get through what is overhead, by its points and those beneath them ----
//
// A wall that is seen from above has its points in a strip without ground; a bar, a wire or a branch has ground in it.
// So the points around a pixel are put in order across the strip that those overhead lie along, and the part of it is
// found where they outnumber the ground most. That holds as many points as it takes at any density: in a thin survey it
// is looked for in more pixels. Ours.

// Points overhead that one beneath outweighs: where pulses are hidden, fewer than one in four gets through.
constexpr int beneath_weight = 3;
// Where half of the pulses get through, points overhead outweigh those of the ground by m somewhere among n with a
// chance of about n exp(-m chance): the log of the root of x^3 = x^2 + x + 1, for steps of +1 and -3 in turn.
constexpr double chance = 0.609;
// Width of the bins across a strip, m, and their number.
constexpr double bin_width = 0.025;
constexpr int bins = 100;
// Bins of what hides the ground, at least: what is narrower than 0.1 m is a wire.
constexpr int narrowest = 4;
// Side of the square that is looked at: a strip as narrow as that and as long has this number of points on average; m,
// at least.
constexpr double strip_points = 12.0, least_side = 1.0;
// Pixels beyond the middle that half a square holds, so that a pixel beside a wall's end is not taken for the wall.
constexpr Index overlap = 2;

// Pixels on either side of one that are looked at, by points per m2 and the side of a pixel, m.
Index strip_half(double density, double pixel) {
    const double side = std::max(least_side, strip_points / (narrowest * bin_width * density));
    return static_cast<Index>(std::ceil(0.5 * (side / pixel - 1.0) - 1e-9));
}

// True if points overhead outweigh those beneath by so much, and more where there are many.
bool outweighs(Index over, Index beneath, double least) {
    return static_cast<double>(over - beneath_weight * beneath) >= least + std::log(static_cast<double>(over)) / chance;
}

// By how much points overhead must outweigh those beneath: by a number, and more where there are many points; or, if
// there is a share, by that share of them and no less than the number.
struct Weight {
    double number, share = 0.0;
};

// Columns and rows of points from the north-west corner of a tile, px, row by row of its pixels; in a pixel the last
// that was added comes first.
class PointsByPixel {
  public:
    std::vector<double> x, y;

    void clear() { added.clear(); }
    void add(Index pixel, double col, double row) { added.push_back({pixel, col, row}); }

    // Puts the points in order, when all are there.
    void sort(Index pixels) {
        begin.assign(pixels + 1, 0);
        for (const Point& point : added) ++begin[point.pixel];
        std::partial_sum(begin.begin(), begin.end(), begin.begin());
        x.resize(added.size());
        y.resize(added.size());
        for (const Point& point : added) {
            const Index place = --begin[point.pixel];
            x[place] = point.x;
            y[place] = point.y;
        }
    }

    // Where those of a pixel begin, and those of the pixels before it end.
    Index first_of(Index pixel) const { return begin[pixel]; }

  private:
    struct Point {
        Index pixel;
        double x, y;
    };

    std::vector<Point> added;
    std::vector<Index> begin;
};

// Points of a tile over the ground and on it, and whether they hide it.
class Strips {
  public:
    explicit Strips(Index pixels) : size(pixels) {}

    PointsByPixel over, beneath;

    // True if what is overhead in a pixel hides the ground: it outweighs what is beneath in a part of the strip around
    // its points, in a square of 2 half + 1 pixels around it. One half of the square will do, or a smaller one of what
    // is low: at a corner walls meet.
    bool hides_ground(Index r, Index c, Index half, Weight least, bool is_low, double pixel) const {
        const Index near = std::max(half / 2, overlap);
        // All of the square, its halves, and one of half its side: pixels to the north, south, west and east.
        const std::array<std::array<Index, 4>, 6> reaches{{
            {half, half, half, half},
            {overlap, half, half, half},
            {half, overlap, half, half},
            {half, half, overlap, half},
            {half, half, half, overlap},
            {near, near, near, near},
        }};
        const std::size_t parts = half <= overlap ? 1 : is_low ? 6 : 5;
        return std::any_of(reaches.begin(), reaches.begin() + parts, [&](const auto& reach) {
            const Window window{
                std::max<Index>(0, r - reach[0]), std::min(size, r + reach[1] + 1), std::max<Index>(0, c - reach[2]),
                std::min(size, c + reach[3] + 1)};
            return strip_weighs(r, c, window, least, pixel);
        });
    }

  private:
    // Rows and columns of pixels, the last ones not included.
    struct Window {
        Index top, bottom, left, right;
    };

    // Calls function(x, y) for the points in a window.
    template <class Function>
    void for_each(const PointsByPixel& points, const Window& window, Function function) const {
        for (Index row = window.top; row < window.bottom; ++row) {
            const Index last = points.first_of(row * size + window.right);
            for (Index i = points.first_of(row * size + window.left); i < last; ++i) function(points.x[i], points.y[i]);
        }
    }

    Index count_over(const Window& window) const {
        Index count = 0;
        for (Index row = window.top; row < window.bottom; ++row)
            count += over.first_of(row * size + window.right) - over.first_of(row * size + window.left);
        return count;
    }

    // True if points overhead outweigh those beneath in the strip of a window around those of a pixel.
    bool strip_weighs(Index r, Index c, const Window& window, Weight least, double pixel) const {
        const Window middle_pixel{r, r + 1, c, c + 1};
        const auto n = static_cast<double>(count_over(window)), own = static_cast<double>(count_over(middle_pixel));
        if (n < least.number || own == 0.0) return false;
        const double x0 = static_cast<double>(c) + 0.5, y0 = static_cast<double>(r) + 0.5;
        double own_x = 0.0, own_y = 0.0, sx = 0.0, sy = 0.0, xx = 0.0, xy = 0.0, yy = 0.0;
        for_each(over, middle_pixel, [&](double x, double y) {
            own_x += x - x0;
            own_y += y - y0;
        });
        for_each(over, window, [&](double col, double row) {
            const double x = col - x0, y = row - y0;
            sx += x;
            sy += y;
            xx += x * x;
            xy += x * y;
            yy += y * y;
        });
        // Across the strip is the direction in which the points vary least.
        xx -= sx * sx / n;
        xy -= sx * sy / n;
        yy -= sy * sy / n;
        const double spread = 0.5 * (xx + yy) - std::sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy);
        double a = xx < yy ? spread - yy : xy, b = xx < yy ? xy : spread - xx;
        const double length = std::sqrt(a * a + b * b);
        const double scale = length > 0.0 ? pixel / bin_width / length : 0.0;
        a *= scale;
        b *= scale;
        const double middle = 0.5 * bins - a * (x0 + own_x / own) - b * (y0 + own_y / own);
        std::array<int, bins + 1> weights{};  // of each bin, behind a zero
        const auto add = [&](double x, double y, int weight) {
            const double across = middle + a * x + b * y;
            if (0.0 <= across && across < bins) weights[static_cast<std::size_t>(across) + 1] += weight;
        };
        for_each(over, window, [&](double x, double y) { add(x, y, 1); });
        for_each(beneath, window, [&](double x, double y) { add(x, y, -beneath_weight); });
        return holds_part(
            least.share > 0.0 ? std::max(least.number, least.share * n) : least.number + std::log(n) / chance, weights);
    }

    // True if a part of a strip around or beside its middle weighs so much.
    static bool holds_part(double least, std::array<int, bins + 1>& sums) {
        for (std::size_t k = 0; k < bins; ++k) sums[k + 1] += sums[k];
        int lowest = sums[0];
        for (std::size_t k = narrowest; k <= bins; ++k) {
            if (k - narrowest <= bins / 2 + 1) lowest = std::min(lowest, sums[k - narrowest]);
            if (k >= bins / 2 && sums[k] - lowest >= least) return true;
        }
        return false;
    }

    const Index size;
};

// ---- Pixels ----

// Pixels with ground that make a surface.
constexpr std::size_t least_ground = 3;
// With fewer points on 3 x 3 pixels on average, canopy is looked for on 5 x 5.
constexpr double few = 4.0;
// Points by which what is overhead must outweigh the ground beneath it to hide it, see `Weight`.
constexpr Weight hiding{6.0};
// Points overhead of a pixel that count in strips, over those that a pixel has on average; two at least.
constexpr double most_of_pixel = 2.0;
// The same, and as a share of the points overhead: of the end of a wall in the corner of a tile, which hides the ground
// if what it continues does. By tests/benchmarks/books.py.
constexpr Weight maybe_hiding{2.0, 0.5};
// Plants so far above the vehicle, m, are crowns: where leaves are dense, more points reach no ground by chance.
constexpr double leafy = 1.0;
constexpr Weight leaves_hiding{13.0};
// Height above the vehicle, m, below which something that hides the ground is a car, a wall or a hedge and no crown.
constexpr double low_above = 3.0;
// Points by which it must outweigh, in a thin survey, for plants that end lower than crowns: a hedge.
constexpr Weight shrub_hiding{1.0};
// Points/m2 below which that holds for all that ends low: a car that lies in two tiles has too few points in each.
constexpr double thinner = 6.0;
// Pixels^2 added to the spread of the known pixels: a few close together say little about the slope.
constexpr double ridge = 1.0;

// Heights above ground from which a point is part of an obstacle, and above which it hangs over the vehicle, m.
struct VehicleBody {
    double lowest_obstacle_m, height_m;
};

// `heights` of the ground, m, NaN where none is known; its points.
struct GroundPatches {
    Array<const float, 3> heights;
    Array<const std::int32_t, 3> spread_count;
};

// Columns of the scalars.
enum Scalar : Index { OBSTACLES, OBSTACLE_HEIGHT, CLEARANCE, CANOPY_SHARE };

// The points of a pixel that are no ground, by their height above it.
struct PixelPoints {
    int seen = 0;             // of the ground
    int body = 0;             // between `low` and `high`
    int above = 0;            // higher
    int under = 0;            // lower
    int tall = 0;             // high above `high`
    int leaves = 0;           // of plants, far above `high`
    int shrubs = 0;           // of plants, not so far above
    int listed = 0;           // that count in strips
    double top = 0.0;         // highest of the body above the ground, m
    double least = infinite;  // lowest above, m

    int company() const { return body + above; }
    int beneath() const { return seen + under; }
};

// The known ground of a tile as a plane over rows and columns of pixels: rises, and the height at the north-western
// one, m.
struct TilePlane {
    double east, south, origin;
};

// A pixel with ground, and its height above the plane, m.
struct KnownGround {
    Index row, col;
    double rest;
};

class ObjectFinder {
  public:
    ObjectFinder(
        const TilePoints& given, Array<const std::uint8_t> kinds, const GroundPatches& measured,
        const VehicleBody& vehicle, double share)
        : points(given),
          kind_of(kinds),
          patches(measured),
          body(vehicle),
          need_share(share),
          size(given.grid.pixels),
          pixel(given.grid.tile_size / static_cast<double>(size)),
          surface(size * size),
          found(surface.size()),
          strips(size) {}

    void find_in(Index t, Array<std::uint8_t, 2> filled, Array<double> numbers) {
        tile = t;
        first = points.starts[t];
        last = points.starts[t + 1];
        state = filled;
        scalars = numbers;
        const std::int32_t* const seen = &patches.spread_count(t, 0, 0);
        std::transform(seen, seen + found.size(), found.begin(), [](int ground_points) {
            return PixelPoints{.seen = ground_points};
        });
        fit_ground();
        const bool is_any_overhead = count_points();
        if (known.size() < least_ground) {
            mark_without_ground();
            return;
        }
        const double density = static_cast<double>(last - first) / (points.grid.tile_size * points.grid.tile_size);
        fill_first_states(density);
        if (is_any_overhead) {
            list_points();
            mark_solids(density);
        }
        summarise();
    }

  private:
    PixelPoints& at(Index r, Index c) { return found[r * size + c]; }
    double& ground(Index r, Index c) { return surface[r * size + c]; }

    // Fits a plane through the known heights, and keeps what each of them is above it.
    void fit_ground() {
        const Array<const float, 2> heights = patches.heights.at(tile);
        const double middle = 0.5 * static_cast<double>(size - 1);
        double base = 0.0;
        PlaneSums sums;
        known.clear();
        for (Index r = 0; r < size; ++r)
            for (Index c = 0; c < size; ++c) {
                const double height = static_cast<double>(heights(r, c));
                ground(r, c) = height;
                if (std::isnan(height)) continue;
                if (known.empty()) base = height;
                known.push_back({r, c, 0.0});
                sums.add(static_cast<double>(c) - middle, static_cast<double>(r) - middle, height - base);
            }
        if (known.size() < least_ground) return;
        const auto [east, south] = *sums.slopes(0.0, ridge);
        const double mean = sums.z / sums.n;
        plane = {east, south, base + mean - east * (middle + sums.x / sums.n) - south * (middle + sums.y / sums.n)};
        for (KnownGround& one : known)
            one.rest = ground(one.row, one.col) - plane.origin - east * static_cast<double>(one.col) -
                       south * static_cast<double>(one.row);
    }

    // Height of the ground in a pixel where none was seen: the plane, and what the nearest heights are above it.
    double continued_ground(Index r, Index c) const {
        double total = 0.0, weights = 0.0;
        for (const KnownGround& one : known) {
            const Index down = one.row - r, right = one.col - c;
            const auto square = static_cast<double>(down * down + right * right);
            const double weight = 1.0 / (square * square);
            weights += weight;
            total += weight * one.rest;
        }
        return plane.origin + plane.east * static_cast<double>(c) + plane.south * static_cast<double>(r) +
               total / weights;
    }

    // Columns and rows of a point from the south-west corner of the tile, px.
    std::array<double, 2> place_of(Index i) const {
        const double side = points.grid.tile_size, pixels = static_cast<double>(size);
        return {
            pixels_from(static_cast<double>(points.col[tile]) * side, points.easting[i], side, pixels),
            pixels_from(static_cast<double>(points.row[tile]) * side, points.northing[i], side, pixels)};
    }

    // Row and column of the pixel there.
    std::array<Index, 2> pixel_of(const std::array<double, 2>& place) const {
        return {
            size - 1 - std::min(size - 1, static_cast<Index>(place[1])),
            std::min(size - 1, static_cast<Index>(place[0]))};
    }

    // Counts the points that are no ground; returns whether any is overhead.
    bool count_points() {
        bool is_any_overhead = false;
        for (Index i = first; i < last; ++i) {
            const std::uint8_t kind = kind_of[i];
            if (kind == POINT_GROUND) continue;
            const auto [r, c] = pixel_of(place_of(i));
            if (std::isnan(ground(r, c)) && known.size() >= least_ground) ground(r, c) = continued_ground(r, c);
            double height = points.upward[i] - ground(r, c);
            if (kind == POINT_BUILDING) height = std::min(height, body.height_m);
            PixelPoints& own = at(r, c);
            if (height > body.height_m) {
                is_any_overhead = true;
                ++own.above;
                own.least = std::min(own.least, height);
                own.tall += height > body.height_m + low_above;
                own.leaves += kind == POINT_PLANT && height > body.height_m + leafy;
                own.shrubs += kind == POINT_PLANT && height <= body.height_m + leafy;
            } else if (height >= body.lowest_obstacle_m) {
                ++own.body;
                own.top = std::max(own.top, height);
            } else {
                ++own.under;
            }
        }
        return is_any_overhead;
    }

    // Lists the points of each pixel for strips: those of objects that stand or hang there, and those beneath.
    void list_points() {
        strips.over.clear();
        strips.beneath.clear();
        // A side that returns points too would have more than its share.
        const double share = most_of_pixel * static_cast<double>(last - first) / static_cast<double>(size * size);
        const int most = std::max(2, static_cast<int>(std::ceil(share)));
        for (Index i = first; i < last; ++i) {
            const std::array<double, 2> place = place_of(i);
            const auto [r, c] = pixel_of(place);
            const bool is_over =
                kind_of[i] != POINT_GROUND && points.upward[i] - ground(r, c) >= body.lowest_obstacle_m;
            if (is_over && at(r, c).listed >= most) continue;
            at(r, c).listed += is_over;
            (is_over ? strips.over : strips.beneath).add(r * size + c, place[0], static_cast<double>(size) - place[1]);
        }
        strips.over.sort(size * size);
        strips.beneath.sort(size * size);
    }

    // Sum of a square around one pixel.
    template <auto count>
    int box_sum(Index r, Index c, Index half) {
        int total = 0;
        for (Index row = std::max<Index>(0, r - half); row < std::min(size, r + half + 1); ++row)
            for (Index col = std::max<Index>(0, c - half); col < std::min(size, c + half + 1); ++col)
                total += std::invoke(count, at(row, col));
        return total;
    }

    // States from the points of the 3 x 3 pixels around each; for canopy, in thin surveys, from those of 5 x 5.
    void fill_first_states(double density) {
        const double points_of_square = 9.0 * pixel * pixel * density;
        const int need = std::max(2, static_cast<int>(std::ceil(need_share * 9.0 * pixel * pixel * density)));
        const Index reach = points_of_square >= few ? 1 : 2;
        for (Index r = 0; r < size; ++r)
            for (Index c = 0; c < size; ++c) {
                const PixelPoints& own = at(r, c);
                int kind = own.beneath() > 0 ? FREE : EMPTY;
                if (own.body > 0) {
                    const bool is_rim = r == 0 || c == 0 || r == size - 1 || c == size - 1;
                    kind = box_sum<&PixelPoints::company>(r, c, 1) >= need ? OBSTACLE : is_rim ? UNDECIDED : LONE;
                } else if (own.above > 0 && box_sum<&PixelPoints::above>(r, c, reach) >= need) {
                    kind = CANOPY;
                }
                state(r, c) = static_cast<std::uint8_t>(kind + (own.seen > 0 ? SEEN : 0));
            }
    }

    // True if what is overhead fills a square around a pixel, and little ground is seen in it.
    bool fills_square(Index r, Index c, double least) {
        for (Index half = 1; half < 4; ++half) {
            const int over = box_sum<&PixelPoints::company>(r, c, half);
            if (over >= least && outweighs(over, box_sum<&PixelPoints::beneath>(r, c, half), least)) return true;
        }
        return false;
    }

    // Marks canopy that hides the ground.
    void mark_solids(double density) {
        const Index half = strip_half(density, pixel);
        const bool is_thin = pixel * pixel * density < thin;
        for (Index r = 0; r < size; ++r)
            for (Index c = 0; c < size; ++c) {
                if (state(r, c) % SEEN != CANOPY) continue;
                const PixelPoints& own = at(r, c);
                const bool is_low = box_sum<&PixelPoints::tall>(r, c, 2) == 0;
                const bool is_shrub = is_thin && own.leaves == 0 && own.shrubs > 0;
                Weight least = own.leaves > 0 ? leaves_hiding : hiding;
                if (is_shrub || (density < thinner && is_low)) least = shrub_hiding;
                int kind = CANOPY;
                if (fills_square(r, c, least.number) || strips.hides_ground(r, c, half, least, is_low, pixel))
                    kind = is_low ? LOW_SOLID : SOLID;
                else if (is_low && strips.hides_ground(r, c, half, maybe_hiding, true, pixel))
                    kind = MAYBE_SOLID;
                state(r, c) = static_cast<std::uint8_t>(state(r, c) + kind - CANOPY);
            }
    }

    // States of a tile whose ground is unknown: what is seen there is an obstacle, whatever its height.
    void mark_without_ground() {
        Index obstacles = 0;
        for (Index r = 0; r < size; ++r)
            for (Index c = 0; c < size; ++c) {
                // Heights above an unknown ground are NaN, and so all its points count as under.
                const bool is_seen = at(r, c).under > 0 && box_sum<&PixelPoints::under>(r, c, 1) > 1;
                state(r, c) = is_seen ? OBSTACLE : UNSEEN;
                obstacles += is_seen;
            }
        std::fill(scalars.begin(), scalars.end(), not_a_number);
        if (obstacles > 0) scalars[OBSTACLES] = static_cast<double>(obstacles) / static_cast<double>(size * size);
    }

    // Fills the scalars of a tile with ground.
    void summarise() {
        Index obstacles = 0, canopy = 0;
        double top = 0.0, least = infinite;
        for (Index r = 0; r < size; ++r)
            for (Index c = 0; c < size; ++c) {
                const PixelPoints& own = at(r, c);
                const bool is_obstacle = state(r, c) % SEEN == OBSTACLE, is_canopy = is_overhead(state(r, c));
                obstacles += is_obstacle;
                if (is_obstacle) top = std::max(top, own.top);
                canopy += is_canopy || (is_obstacle && own.above > 0);
                if (is_canopy) least = std::min(least, own.least);
            }
        const auto pixels = static_cast<double>(size * size);
        scalars[OBSTACLES] = static_cast<double>(obstacles) / pixels;
        scalars[OBSTACLE_HEIGHT] = top;
        scalars[CLEARANCE] = least < infinite ? least : not_a_number;
        scalars[CANOPY_SHARE] = static_cast<double>(canopy) / pixels;
    }

    const TilePoints points;
    const Array<const std::uint8_t> kind_of;
    const GroundPatches patches;
    const VehicleBody body;
    const double need_share;
    const Index size;
    const double pixel;
    std::vector<double> surface;  // (pixels, pixels) ground, m
    std::vector<PixelPoints> found;
    std::vector<KnownGround> known;
    Strips strips;
    TilePlane plane{};
    Index tile = 0, first = 0, last = 0;
    Array<std::uint8_t, 2> state;
    Array<double> scalars;
};

// Fills the state of each pixel and the scalars of every tile; all of them have points. `share`: points that make an
// obstacle, of those that the tile has on 3 x 3 pixels on average; two at least.
void find_in_tiles(
    TilePoints points, Array<const std::uint8_t> kind, GroundPatches patches, VehicleBody body, double share,
    Array<std::uint8_t, 3> state, Array<double, 2> scalars) {
    ObjectFinder finder(points, kind, patches, body, share);
    for (Index t = 0; t < points.tiles(); ++t) finder.find_in(t, state.at(t), scalars.at(t));
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::VehicleBody, lowest_obstacle_m, height_m)
BUMPY_RECORD(bumpy::GroundPatches, heights, spread_count)

BUMPY_LOOPS(objects, find_in_tiles)
