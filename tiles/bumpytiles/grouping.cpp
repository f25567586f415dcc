// Groups points by block of tiles, and sorts those of a block: by tile, and inside a tile into one canonical order.
//
// The points are put tile by tile first, and those of a tile are sorted while they are in the processor's cache. Their
// order is that of a hash of where they are inside the tile: a tile that is moved by whole tiles, raised, turned by 90
// degrees or mirrored keeps it. Hashes are evenly spread, so a tile is cut into as many buckets as it has points by the
// leading bits, and only the few points of a bucket are compared. Ours; see grouping.py for the arrays.
#include "grouping.hpp"

#include <bit>

#include "bindings.hpp"

namespace bumpy {
namespace {

constexpr Index tiles_of_block = block_tiles * block_tiles;

// ---- The block and the tile of each point ----

template <class Number>
struct Coordinates {
    Array<const Number> easting, northing, upward;
};

template <class Number, class Byte>
struct Tiled {
    Array<Number> easting, northing, upward;
    Array<Byte> tile, flag;
};

template <class Number>
using TiledOut = Tiled<Number, std::uint8_t>;
template <class Number>
using TiledIn = Tiled<const Number, const std::uint8_t>;

struct BlockWindow {
    double tile_size;
    Index first_col, first_row, cols;

    Index cell(Index col, Index row) const {
        return (floor_divide(row, block_tiles) - first_row) * cols + floor_divide(col, block_tiles) - first_col;
    }
};

struct TileBorders {
    Array<const Index> easting, northing;
    double tiles_per_easting, tiles_per_northing;
    Index first_col, first_row;
};

struct Grouping {
    Array<std::int32_t> cell;
    Array<std::uint8_t> tile;
};

std::uint8_t tile_of_block(Index col, Index row) {
    return static_cast<std::uint8_t>(modulo(row, block_tiles) * block_tiles + modulo(col, block_tiles));
}

void count_points(Coordinates<double> points, BlockWindow window, Array<Index> counts, Grouping out) {
    for (Index i = 0; i < points.easting.size(); ++i) {
        const Index col = tile_index(points.easting[i], window.tile_size);
        const Index row = tile_index(points.northing[i], window.tile_size);
        const Index cell = window.cell(col, row);
        out.cell[i] = static_cast<std::int32_t>(cell);
        out.tile[i] = tile_of_block(col, row);
        ++counts[cell + 1];
    }
}

// The interval between borders that holds a number; an interval is about 1 / per_tile wide.
Index interval_of(Index number, Array<const Index> borders, double per_tile) {
    const auto guess = static_cast<Index>(static_cast<double>(number - borders[0]) * per_tile);
    Index i = std::min(std::max(guess, Index{0}), borders.size() - 2);
    while (number < borders[i]) --i;
    while (number >= borders[i + 1]) ++i;
    return i;
}

// Points of a file's own grid: by the borders of the tiles, without their coordinates.
void count_scaled_points(
    Coordinates<std::int32_t> points, TileBorders borders, BlockWindow window, Array<Index> counts, Grouping out) {
    Index x_first = 0, x_end = 0, y_first = 0, y_end = 0;  // of the tile of the point before
    Index cell = 0, run = 0;
    std::uint8_t tile = 0;
    for (Index i = 0; i < points.easting.size(); ++i) {
        const Index x = points.easting[i], y = points.northing[i];
        // Neighbours in a file are neighbours on the ground.
        if (!(x_first <= x && x < x_end && y_first <= y && y < y_end)) {
            counts[cell + 1] += run;
            run = 0;
            const Index col = interval_of(x, borders.easting, borders.tiles_per_easting);
            const Index row = interval_of(y, borders.northing, borders.tiles_per_northing);
            x_first = borders.easting[col];
            x_end = borders.easting[col + 1];
            y_first = borders.northing[row];
            y_end = borders.northing[row + 1];
            cell = window.cell(col + borders.first_col, row + borders.first_row);
            tile = tile_of_block(col + borders.first_col, row + borders.first_row);
        }
        ++run;
        out.cell[i] = static_cast<std::int32_t>(cell);
        out.tile[i] = tile;
    }
    counts[cell + 1] += run;
}

// Puts points block by block, in their own order inside a block; `place` is where each block's next point goes.
template <class Number>
void scatter(
    Coordinates<Number> points, Array<const std::uint8_t> flag, Grouping found, Array<Index> place,
    TiledOut<Number> out) {
    for (Index i = 0; i < flag.size(); ++i) {
        const Index p = place[found.cell[i]]++;
        out.easting[p] = points.easting[i];
        out.northing[p] = points.northing[i];
        out.upward[p] = points.upward[i];
        out.tile[p] = found.tile[i];
        out.flag[p] = flag[i];
    }
}

void scatter_colours(
    Array<const std::uint32_t> colour, Array<const std::int32_t> cell, Array<Index> place, Array<std::uint32_t> out) {
    for (Index i = 0; i < colour.size(); ++i) out[place[cell[i]]++] = colour[i];
}

// ---- The points of a block, tile by tile ----

struct Marked {
    Array<double> easting, northing, upward;
    Array<std::uint8_t> flag;
};

// The picture of a block that points are painted on.
struct BlockPhoto {
    Array<const Index> corner;
    double tile_size;
    Index pixels;
    Array<double> height;
    Array<std::uint32_t> colour;
};

// Reads points in metres, whatever they are stored in.
struct InMetres {
    TiledIn<double> points;

    std::array<double, 3> operator()(Index i) const {
        return {points.easting[i], points.northing[i], points.upward[i]};
    }
};

struct OnFileGrid {
    TiledIn<std::int32_t> points;
    Scaling scaling;

    std::array<double, 3> operator()(Index i) const {
        return {
            scaling.metres(points.easting[i], 0), scaling.metres(points.northing[i], 1),
            scaling.metres(points.upward[i], 2)};
    }
};

void count_tiles(Array<const std::uint8_t> tile, Array<Index> first) {
    for (const std::uint8_t t : tile) ++first[t + 1];
}

// A pixel shows the highest of its points; of two at one height the larger colour, so that their order does not matter.
void paint(const std::array<double, 3>& point, Index tile, std::uint32_t colour, const BlockPhoto& photo) {
    const double size = photo.tile_size, pixels = static_cast<double>(photo.pixels);
    const double west = static_cast<double>(photo.corner[0] + tile % block_tiles) * size;
    const double south = static_cast<double>(photo.corner[1] + tile / block_tiles) * size;
    const Index last = photo.pixels - 1;
    // Points of a damaged pack may lie in another tile.
    const auto inside = [&](double place) { return static_cast<Index>(std::clamp(place, 0.0, pixels - 1.0)); };
    const Index col = inside(pixels_from(west, point[0], size, pixels));
    const Index row = inside(pixels_from(south, point[1], size, pixels));
    const Index p = (tile * photo.pixels + last - row) * photo.pixels + col;
    if (point[2] > photo.height[p] || (point[2] == photo.height[p] && colour > photo.colour[p])) {
        photo.height[p] = point[2];
        photo.colour[p] = colour;
    }
}

// Puts points tile by tile; `following` is where each tile's next point goes. Points with a colour are painted.
template <class Reader, class Points>
void place(
    Reader read, Points points, Array<const std::uint32_t> colour, Array<Index> following, Marked out,
    BlockPhoto photo) {
    for (Index i = 0; i < points.tile.size(); ++i) {
        const Index tile = points.tile[i];
        const Index p = following[tile]++;
        const std::array<double, 3> point = read(i);
        out.easting[p] = point[0];
        out.northing[p] = point[1];
        out.upward[p] = point[2];
        out.flag[p] = points.flag[i];
        if (colour.size() > 0 && colour[i] != 0) paint(point, tile, colour[i], photo);
    }
}

void place_points(
    TiledIn<double> points, Array<const std::uint32_t> colour, Array<Index> following, Marked out, BlockPhoto photo) {
    place(InMetres{points}, points, colour, following, out, photo);
}

void place_scaled_points(
    TiledIn<std::int32_t> points, Array<const double> scaling, Array<const std::uint32_t> colour,
    Array<Index> following, Marked out, BlockPhoto photo) {
    place(OnFileGrid{points, {scaling}}, points, colour, following, out, photo);
}

// ---- The points of a tile in their order ----

struct SortScratch {
    Array<std::uint64_t> key;
    Array<std::int32_t> bucket, order;
    Array<std::uint64_t> rank;
};

// Bits of the hash of a point by which the points of a tile are ordered.
constexpr int key_bits = 56;
// Steps a metre of the offsets that are hashed: coarser than the rounding of coordinates of any size.
constexpr double hash_steps = 1e6;

// 64 well-mixed bits of three numbers: multiply and fold each, then Stafford's finaliser.
std::uint64_t hash_point(double x, double y, double z) {
    std::uint64_t mixed = 0;
    const auto fold = [&mixed](double number, std::uint64_t factor) {
        mixed = (mixed ^ std::bit_cast<std::uint64_t>(number + 0.0)) * factor;  // -0.0 becomes 0.0
        mixed ^= mixed >> 32;
    };
    fold(x, 0x9E3779B97F4A7C15U);
    fold(y, 0xC2B2AE3D27D4EB4FU);
    fold(z, 0x165667B19E3779F9U);
    mixed *= 0xD6E8FEB86659FD93U;
    return mixed ^ (mixed >> 32);
}

double from_middle(double coordinate, double first, double size) {
    return std::abs(std::rint((coordinate - first) * hash_steps) - 0.5 * size * hash_steps);
}

// Hashes where points are: how far from the middle of the tile, to either side, and above its lowest point.
void fill_keys(Index count, double west, double south, double size, const Marked& tile, Array<std::uint64_t> key) {
    const double low = *std::min_element(tile.upward.begin(), tile.upward.begin() + count);
    for (Index j = 0; j < count; ++j) {
        const double x = from_middle(tile.easting[j], west, size), y = from_middle(tile.northing[j], south, size);
        const double z = std::rint((tile.upward[j] - low) * hash_steps);
        key[j] = hash_point(std::min(x, y), std::max(x, y), z) >> (64 - key_bits);
    }
}

// Puts the first points of the tile into `order` by the leading bits of their keys.
void fill_buckets(Index count, const SortScratch& scratch) {
    const int width = std::max(1, static_cast<int>(std::bit_width(static_cast<std::uint64_t>(count - 1))));
    const Index buckets = Index{1} << width;
    const auto bucket_of = [&](Index j) { return static_cast<Index>(scratch.key[j] >> (key_bits - width)); };
    std::fill(scratch.bucket.begin(), scratch.bucket.begin() + buckets + 1, 0);
    for (Index j = 0; j < count; ++j) ++scratch.bucket[bucket_of(j) + 1];
    for (Index b = 1; b <= buckets; ++b) scratch.bucket[b] += scratch.bucket[b - 1];
    for (Index j = 0; j < count; ++j) {
        const Index p = scratch.bucket[bucket_of(j)]++;
        scratch.order[p] = static_cast<std::int32_t>(j);
        scratch.rank[p] = scratch.key[j];
    }
}

bool same_place(const Marked& a, Index i, const Marked& b, Index j) {
    return a.easting[i] == b.easting[j] && a.northing[i] == b.northing[j] && a.upward[i] == b.upward[j];
}

// True if point o goes behind point i, where their keys are equal. Flags: 1, 2, ... 255, 0.
bool comes_later(const Marked& points, Index o, Index i) {
    if (points.easting[o] != points.easting[i]) return points.easting[o] > points.easting[i];
    if (points.northing[o] != points.northing[i]) return points.northing[o] > points.northing[i];
    if (points.upward[o] != points.upward[i]) return points.upward[o] > points.upward[i];
    return static_cast<std::uint8_t>(points.flag[o] - 1) > static_cast<std::uint8_t>(points.flag[i] - 1);
}

// Sorts the first points of `order` by insertion: the buckets have nearly sorted them.
void insert_by_key(const Marked& points, Index count, Array<std::int32_t> order, Array<std::uint64_t> rank) {
    for (Index j = 1; j < count; ++j) {
        const std::int32_t i = order[j];
        const std::uint64_t key = rank[j];
        Index m = j;
        for (; m > 0; --m) {
            const std::int32_t o = order[m - 1];
            if (rank[m - 1] < key || (rank[m - 1] == key && !comes_later(points, o, i))) break;
            order[m] = o;
            rank[m] = rank[m - 1];
        }
        order[m] = i;
        rank[m] = key;
    }
}

// Sorts points, tile by tile, inside their tiles by the hash of where they are, then by coordinates; drops exact
// duplicates.
void sort_tiles(
    Array<const Index> first, Array<Index> starts, Array<const Index> corner, double size, Marked points, Marked tile,
    SortScratch scratch) {
    Index kept = 0;
    for (Index t = 0; t < tiles_of_block; ++t) {
        starts[t] = kept;
        const Index begin = first[t], count = first[t + 1] - begin;
        if (count == 0) continue;
        std::copy_n(points.easting.data + begin, count, tile.easting.data);
        std::copy_n(points.northing.data + begin, count, tile.northing.data);
        std::copy_n(points.upward.data + begin, count, tile.upward.data);
        std::copy_n(points.flag.data + begin, count, tile.flag.data);
        const double west = static_cast<double>(corner[0] + t % block_tiles) * size;
        const double south = static_cast<double>(corner[1] + t / block_tiles) * size;
        fill_keys(count, west, south, size, tile, scratch.key);
        fill_buckets(count, scratch);
        insert_by_key(tile, count, scratch.order, scratch.rank);
        for (Index j = 0; j < count; ++j) {
            const Index i = scratch.order[j];
            if (j > 0 && scratch.rank[j] == scratch.rank[j - 1] && same_place(points, kept - 1, tile, i)) continue;
            points.easting[kept] = tile.easting[i];
            points.northing[kept] = tile.northing[i];
            points.upward[kept] = tile.upward[i];
            points.flag[kept] = tile.flag[i];
            ++kept;
        }
    }
    starts[tiles_of_block] = kept;
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::Coordinates<double>, easting, northing, upward)
BUMPY_RECORD(bumpy::Coordinates<std::int32_t>, easting, northing, upward)
BUMPY_RECORD(bumpy::TiledOut<double>, easting, northing, upward, tile, flag)
BUMPY_RECORD(bumpy::TiledOut<std::int32_t>, easting, northing, upward, tile, flag)
BUMPY_RECORD(bumpy::TiledIn<double>, easting, northing, upward, tile, flag)
BUMPY_RECORD(bumpy::TiledIn<std::int32_t>, easting, northing, upward, tile, flag)
BUMPY_RECORD(bumpy::BlockWindow, tile_size, first_col, first_row, cols)
BUMPY_RECORD(bumpy::TileBorders, easting, northing, tiles_per_easting, tiles_per_northing, first_col, first_row)
BUMPY_RECORD(bumpy::Grouping, cell, tile)
BUMPY_RECORD(bumpy::Marked, easting, northing, upward, flag)
BUMPY_RECORD(bumpy::BlockPhoto, corner, tile_size, pixels, height, colour)
BUMPY_RECORD(bumpy::SortScratch, key, bucket, order, rank)

void bind_grouping(nb::module_& module) {
    using namespace bumpy;
    BUMPY_LOOP(module, count_points);
    BUMPY_LOOP(module, count_scaled_points);
    module.def("scatter_points", &scatter<double>, free_interpreter());
    module.def("scatter_scaled_points", &scatter<std::int32_t>, free_interpreter());
    BUMPY_LOOP(module, scatter_colours);
    BUMPY_LOOP(module, count_tiles);
    BUMPY_LOOP(module, place_points);
    BUMPY_LOOP(module, place_scaled_points);
    BUMPY_LOOP(module, sort_tiles);
}
