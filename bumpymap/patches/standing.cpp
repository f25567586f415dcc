// Narrow objects with steep sides in heightmaps (`find_standing` in features.py), and tiles without them.
//
// The surface beneath objects is a morphological opening of the heights. What rises above it is that of an object where
// enough of it lies near steep sides, once the slope of the ground is taken off. Ours.
#include <numbers>

#include "bumpymap/patches/heightmap.hpp"
#include "bumpymap/patches/offsets.hpp"
#include "bumpytiles/bindings.hpp"

namespace bumpy {
namespace {

constexpr float unseen_height = std::numeric_limits<float>::infinity();

// ---- Pixels of objects ----

// Known pixels around one among which the foot of its side is looked for, at least: in thin surveys they lie apart.
constexpr int foot_pixels = 8;
// Farthest of them, px.
constexpr int farthest_foot = 4;
// If more of the raised pixels are level with ground, as a share, nothing stands there: they are the rim of a narrow
// ditch, between pixels in it.
constexpr double level_share = 0.5;
// Height of tall pixels above what lies beneath, as a multiple of the drop of a side: 0.5 m for a belly 0.25 m above
// the ground.
constexpr double taller = 2.5;
// Points on a line, see `slopes_of`.
constexpr double line_of_tiles = 1e-6;

struct StandingLimits {
    double width, foot, raised, drop, least, share;
    Index around, pixels;
};

// A map of pixels, with a margin around them that holds one value.
template <class Value>
struct Map {
    Map(Index rows, Index cols, Index beyond = 0, Value outside = {})
        : values((rows + 2 * beyond) * (cols + 2 * beyond), outside), wide(cols + 2 * beyond), margin(beyond) {}

    Value* row(Index r) { return values.data() + (r + margin) * wide + margin; }
    Value& operator()(Index r, Index c) { return row(r)[c]; }

    std::vector<Value> values;
    Index wide, margin;
};

// Raised pixels: of all of them, those on a side, those far above what lies beneath, those of both kinds, and those
// that are level with ground and so not tall.
struct Raised {
    int all = 0, side = 0, tall = 0, tall_side = 0, level = 0;

    Raised& add(const Raised& more, int times) {
        all += times * more.all;
        side += times * more.side;
        tall += times * more.tall;
        tall_side += times * more.tall_side;
        level += times * more.level;
        return *this;
    }
};

// Where the foot of a side may be: places to it in a map, and how much lower it is then, m.
struct Foot {
    Index way;
    int square;
    bool is_far;
    double drop;
};

// The known heights of a tile for a least-squares plane through several tiles: their sums [px, m] about the middle of
// the tile and one of the heights.
struct TileSums {
    double base = 0.0;
    PlaneSums sums;
};

// Lowers numbers, none of them NaN, to those of another row.
void lower(const float* values, float* out, Index count) {
    for (Index c = 0; c < count; ++c) out[c] = std::min(out[c], values[c]);
}

// Fills the lowest value within a disc around each pixel.
void fill_lowest_on_disc(Map<float>& values, double radius, Map<float>& out) {
    const Index cols = values.wide, rows = static_cast<Index>(values.values.size()) / std::max<Index>(cols, 1);
    const auto reach = static_cast<Index>(radius);
    std::fill(out.values.begin(), out.values.end(), unseen_height);
    std::vector<float> line(cols + 2 * reach, unseen_height), lowest(cols);
    for (Index r = 0; r < rows; ++r) {
        std::copy_n(values.row(r), cols, line.data() + reach);
        std::copy_n(values.row(r), cols, lowest.data());
        for (Index half = 0; half <= reach; ++half) {  // half the width of the disc
            lower(line.data() + reach - half, lowest.data(), cols);
            lower(line.data() + reach + half, lowest.data(), cols);
            for (Index down = std::max(-reach, -r); down <= std::min(reach, rows - 1 - r); ++down) {
                const auto inside = static_cast<double>(half * half + down * down);
                const auto outside = static_cast<double>((half + 1) * (half + 1) + down * down);
                if (inside <= radius * radius && radius * radius < outside)
                    lower(lowest.data(), out.row(r + down), cols);
            }
        }
    }
}

class StandingFinder {
  public:
    StandingFinder(Array<const float, 2> given, const StandingLimits& sizes, Array<bool, 2> found)
        : heights(given),
          limits(sizes),
          marks(found),
          rows(given.shape[0]),
          cols(given.shape[1]),
          above(rows, cols),
          level(rows, cols, farthest_foot, unknown_height),
          pixels(rows, cols) {
        for (const Offset& offset : nearest_offsets(farthest_foot)) {
            const int square = offset.square();
            const auto far = static_cast<double>(square);
            const double drop = limits.drop * std::max(1.0, std::sqrt(far) / limits.foot);
            if (square > 0)
                feet.push_back(
                    {offset.down * level.wide + offset.right, square, far > limits.foot * limits.foot, drop});
        }
    }

    void mark() {
        std::fill_n(marks.data, marks.count(), false);
        fill_above();
        std::ranges::transform(above.values, pixels.values.begin(), [this](float height) {
            return Raised{.all = limits.raised < height && height < unseen_height};
        });
        if (std::ranges::none_of(pixels.values, [](const Raised& own) { return own.all; })) return;
        fill_level();
        for (Index r = 0; r < rows; ++r)
            for (Index c = 0; c < cols; ++c)
                if (pixels(r, c).all) describe_raised(r, c);
        Map<Raised> sums(rows + 1, cols + 1);  // of the pixels north-west of each corner
        for (Index r = 0; r < rows; ++r)
            for (Index c = 0; c < cols; ++c)
                sums(r + 1, c + 1) =
                    Raised(pixels(r, c)).add(sums(r, c + 1), 1).add(sums(r + 1, c), 1).add(sums(r, c), -1);
        for (Index r = 0; r < rows; ++r)
            for (Index c = 0; c < cols; ++c) marks(r, c) = pixels(r, c).all && is_of_object(r, c, sums);
    }

  private:
    // Fills how far each pixel is above the surface that a disc can touch from below: a morphological opening. Its
    // heights are some of those that are given, so the ground around has no part in their rounding.
    void fill_above() {
        Map<float> low(rows, cols), beneath(rows, cols);
        for (Index k = 0; k < heights.count(); ++k)
            above.values[k] = std::isnan(heights.data[k]) ? unseen_height : heights.data[k];
        fill_lowest_on_disc(above, limits.width, low);
        for (float& height : low.values) height = height < unseen_height ? -height : unseen_height;
        fill_lowest_on_disc(low, limits.width, beneath);  // upside down, for the highest
        for (std::size_t k = 0; k < above.values.size(); ++k) above.values[k] += beneath.values[k];
    }

    TileSums sums_of_tile(Index row, Index col) const {
        const double middle = 0.5 * static_cast<double>(limits.pixels - 1);
        TileSums tile;
        for (Index r = 0; r < limits.pixels; ++r)
            for (Index c = 0; c < limits.pixels; ++c) {
                const auto height = static_cast<double>(heights(row * limits.pixels + r, col * limits.pixels + c));
                if (std::isnan(height)) continue;
                if (tile.sums.n == 0.0) tile.base = height;
                tile.sums.add(static_cast<double>(c) - middle, static_cast<double>(r) - middle, height - tile.base);
            }
        return tile;
    }

    // Height of the plane through four tiles at their common corner, north-west of one; NaN without any. It is their
    // mean height if they span no plane.
    double height_between(Index row, Index col, Map<TileSums>& tiles) const {
        const Index tile_rows = rows / limits.pixels, tile_cols = cols / limits.pixels;
        const auto side = static_cast<double>(limits.pixels);
        double base = 0.0;
        PlaneSums all;
        for (Index k = 0; k < 4; ++k) {
            const Index r = row - 1 + k / 2, c = col - 1 + k % 2;
            if (!(0 <= r && r < tile_rows && 0 <= c && c < tile_cols) || tiles(r, c).sums.n == 0.0) continue;
            const PlaneSums& own = tiles(r, c).sums;
            if (all.n == 0.0) base = tiles(r, c).base;
            const double x = side * (static_cast<double>(c - col) + 0.5),
                         y = side * (static_cast<double>(r - row) + 0.5), z = tiles(r, c).base - base, m = own.n;
            all.n += m;
            all.x += own.x + m * x;
            all.y += own.y + m * y;
            all.z += own.z + m * z;
            all.xx += own.xx + 2.0 * x * own.x + m * x * x;
            all.yy += own.yy + 2.0 * y * own.y + m * y * y;
            all.xy += own.xy + x * own.y + y * own.x + m * x * y;
            all.xz += own.xz + x * own.z + z * own.x + m * x * z;
            all.yz += own.yz + y * own.z + z * own.y + m * y * z;
        }
        if (all.n == 0.0) return not_a_number;
        const double mx = all.x / all.n, my = all.y / all.n, mz = all.z / all.n;
        const double xx = all.xx - all.x * mx, xy = all.xy - all.x * my, yy = all.yy - all.y * my;
        const double xz = all.xz - all.x * mz, yz = all.yz - all.y * mz, det = xx * yy - xy * xy;
        if (det <= line_of_tiles * xx * yy) return base + mz;
        return base + mz - mx * (xz * yy - yz * xy) / det - my * (yz * xx - xz * xy) / det;
    }

    // Fills how far pixels are above a smooth surface: straight lines between its heights at the corners of tiles.
    // These are those of planes, through the four tiles around each: pixels beside one another differ by no slope.
    void fill_level() {
        const Index tile_rows = rows / limits.pixels, tile_cols = cols / limits.pixels;
        Map<TileSums> tiles(tile_rows, tile_cols);
        for (Index r = 0; r < tile_rows; ++r)
            for (Index c = 0; c < tile_cols; ++c) tiles(r, c) = sums_of_tile(r, c);
        Map<double> corners(tile_rows + 1, tile_cols + 1);
        for (Index r = 0; r <= tile_rows; ++r)
            for (Index c = 0; c <= tile_cols; ++c) corners(r, c) = height_between(r, c, tiles);
        std::vector<double> share(limits.pixels);  // of the way through its tile, of a row or column
        for (Index k = 0; k < limits.pixels; ++k)
            share[k] = (static_cast<double>(k) + 0.5) / static_cast<double>(limits.pixels);
        for (Index r = 0; r < tile_rows * limits.pixels; ++r) {
            const Index row = r / limits.pixels;
            const double down = share[r % limits.pixels];
            for (Index col = 0; col < tile_cols; ++col) {
                const double west_north = corners(row, col), rise_north = corners(row, col + 1) - west_north;
                const double west_south = corners(row + 1, col), rise_south = corners(row + 1, col + 1) - west_south;
                const float* const from = &heights(r, col * limits.pixels);
                float* const out = level.row(r) + col * limits.pixels;
                for (Index k = 0; k < limits.pixels; ++k) {
                    const double north = west_north + share[k] * rise_north, south = west_south + share[k] * rise_south;
                    out[k] = static_cast<float>(static_cast<double>(from[k]) - (north + down * (south - north)));
                }
            }
        }
    }

    void describe_raised(Index r, Index c) {
        Raised& own = pixels(r, c);
        own.side = is_side(r, c);
        own.level = is_level(r, c);
        own.tall = !own.level && static_cast<double>(above(r, c)) > taller * limits.drop;
        own.tall_side = own.side && own.tall;
    }

    // True if a pixel lies far above one within `foot`, or as steeply above one of the nearest known ones.
    bool is_side(Index r, Index c) {
        const float* const own = &level(r, c);
        int known = 0, last = 0;
        for (const Foot& foot : feet) {
            if (foot.is_far && foot.square > last && known >= foot_pixels) return false;
            last = foot.square;
            const float height = own[foot.way];
            known += !std::isnan(height);
            if (static_cast<double>(*own - height) > foot.drop) return true;  // NaN is not
        }
        return false;
    }

    // True if ground that is not raised lies beside a raised pixel, and hardly below it.
    bool is_level(Index r, Index c) {
        for (Index row = std::max<Index>(r - 1, 0); row < std::min(r + 2, rows); ++row)
            for (Index col = std::max<Index>(c - 1, 0); col < std::min(c + 2, cols); ++col)
                if (!pixels(row, col).all && level(row, col) > level(r, c) - 0.5 * limits.drop) return true;
        return false;
    }

    // True if a raised pixel is one of an object: of the raised ones around enough are sides, or of the tall ones.
    bool is_of_object(Index r, Index c, Map<Raised>& sums) {
        const Index top = std::max<Index>(r - limits.around, 0), bottom = std::min(r + limits.around + 1, rows);
        const Index left = std::max<Index>(c - limits.around, 0), right = std::min(c + limits.around + 1, cols);
        Raised around = sums(bottom, right);
        around.add(sums(top, right), -1).add(sums(bottom, left), -1).add(sums(top, left), 1);
        const bool is_steep = around.side > limits.share * around.all && around.level <= level_share * around.all;
        const bool is_tall = pixels(r, c).tall && around.tall_side > limits.share * around.tall;
        return (is_steep || is_tall) && static_cast<double>(above(r, c)) >= limits.least;
    }

    const Array<const float, 2> heights;
    const StandingLimits limits;
    const Array<bool, 2> marks;
    const Index rows, cols;
    Map<float> above;  // what lies beneath objects, m; infinite where nothing is known
    Map<float> level;  // a smooth surface, m
    Map<Raised> pixels;
    std::vector<Foot> feet;  // the nearest first
};

// Marks the pixels of objects.
void mark_standing(Array<const float, 2> heights, StandingLimits limits, Array<bool, 2> marks) {
    StandingFinder(heights, limits, marks).mark();
}

// ---- Tiles without objects ----

// Least points of a tile with a heightmap, and share of its pixels that hold one.
struct BareSettings {
    Index min_points;
    double min_coverage;
};

// `heights` of the points in each pixel, m, NaN where there are none; numbers and variances, m^2, of these; relief, m,
// NaN in tiles that cannot be rated from their heightmap.
struct BarePatches {
    Array<const float, 3> heights;
    Array<std::int32_t, 3> spread_count;
    Array<float, 3> spread_variance, relief_map;
};

// Columns of the scalars.
enum Scalar : Index { POINTS, COVERAGE, RELIEF, SLOPE };

// Angle of the least-squares plane through the known heights, degrees; NaN where they span none.
double slope_of(Array<const double, 2> heights, double pixel) {
    const Index size = heights.shape[0];
    double base = 0.0;
    PlaneSums sums;
    for (Index r = 0; r < size; ++r)
        for (Index c = 0; c < size; ++c) {
            const double height = heights(r, c);
            if (std::isnan(height)) continue;
            if (sums.n == 0.0) base = height;
            sums.add(static_cast<double>(c) * pixel, static_cast<double>(r) * pixel, height - base);
        }
    if (sums.n < 3.0) return not_a_number;
    const std::optional<Slopes> slopes = sums.slopes(line_of_pixels);
    if (!slopes) return not_a_number;
    const auto [east, south] = *slopes;
    return std::acos(1.0 / std::sqrt(1.0 + east * east + south * south)) * (180.0 / std::numbers::pi);
}

// A tile, (pixels, pixels) each.
struct BareTile {
    Array<const bool, 2> standing;
    Array<const float, 2> heights;
    Array<std::int32_t, 2> held;
    Array<float, 2> variance, relief;
    Array<double> scalars;

    bool is_left(Index k) const { return held.data[k] > 0 && !standing.data[k]; }
};

// Fills points and coverage of what is left of a tile; returns the share of its nine parts that hold a point, see
// `share_of_parts`.
double count_left(const BareTile& tile) {
    const Index size = tile.standing.shape[0];
    Index points = 0, known = 0;
    int seen = 0;
    for (Index k = 0; k < tile.standing.count(); ++k)
        if (tile.is_left(k)) {
            points += tile.held.data[k];
            ++known;
            seen |= 1 << (3 * (3 * (k / size) / size) + 3 * (k % size) / size);
        }
    tile.scalars[POINTS] = static_cast<double>(points);
    tile.scalars[COVERAGE] = static_cast<double>(known) / static_cast<double>(size * size);
    return share_of_parts(seen);
}

// Takes objects out of the relief of a tile; returns false, and changes nothing, where too little is left. `level` is
// scratch.
bool keep_left(
    const BareTile& tile, const BareSettings& settings, Index thin_points, double thin_seen, Array<double, 2> level) {
    const double seen = count_left(tile), points = tile.scalars[POINTS];
    if (std::isnan(tile.relief.data[0])) return points >= static_cast<double>(thin_points) && seen >= thin_seen;
    if (points < static_cast<double>(settings.min_points) || tile.scalars[COVERAGE] < settings.min_coverage)
        return false;
    for (Index k = 0; k < level.count(); ++k)
        level.data[k] = tile.is_left(k) ? static_cast<double>(tile.relief.data[k]) : not_a_number;
    std::vector<float> relief(level.count());
    tile.scalars[RELIEF] = fill_relief(level, level.shape[0], false, {relief.data(), level.shape});
    if (std::isnan(tile.scalars[RELIEF])) return false;
    std::ranges::copy(relief, tile.relief.data);
    return true;
}

// Takes standing objects, however wide, out of tiles of a side, m; those that cannot be rated so stay. Without a
// heightmap it takes `thin_points`, which lie in that share of its nine parts. Fills `scalars` of tiles that are bare.
void leave_out_objects(
    Array<const bool, 3> standing, BarePatches patches, double side, BareSettings settings, Index thin_points,
    double thin_seen, Array<double, 2> scalars, Array<bool> is_bare) {
    const Index size = standing.shape[1];
    std::vector<double> levels(size * size);
    const Array<double, 2> level{levels.data(), {size, size}};
    for (Index t = 0; t < is_bare.size(); ++t) {
        const BareTile tile{
            standing.at(t),           patches.heights.at(t), patches.spread_count.at(t), patches.spread_variance.at(t),
            patches.relief_map.at(t), scalars.at(t)};
        const bool* marks = tile.standing.data;
        const bool is_any = std::find(marks, marks + size * size, true) != marks + size * size;
        is_bare[t] = is_any && keep_left(tile, settings, thin_points, thin_seen, level);
        if (!is_bare[t]) continue;
        for (Index k = 0; k < level.count(); ++k) {
            if (marks[k]) {
                tile.held.data[k] = 0;
                tile.variance.data[k] = unknown_height;
            }
            level.data[k] = tile.held.data[k] > 0 ? static_cast<double>(tile.heights.data[k]) : not_a_number;
        }
        tile.scalars[SLOPE] = slope_of(level, side / static_cast<double>(size));
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::StandingLimits, width, foot, raised, drop, least, share, around, pixels)
BUMPY_RECORD(bumpy::BareSettings, min_points, min_coverage)
BUMPY_RECORD(bumpy::BarePatches, heights, spread_count, spread_variance, relief_map)

void bind_standing(nb::module_& module) {
    using namespace bumpy;
    BUMPY_LOOP(module, mark_standing);
    BUMPY_LOOP(module, leave_out_objects);
    module.attr("FARTHEST_FOOT") = farthest_foot;
}
