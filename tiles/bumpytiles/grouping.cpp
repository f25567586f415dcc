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

// Points with their tile inside the block; without colours, of which 0 is none, where none has one.
template <class Number, class Byte, class Colour>
struct Tiled {
    Array<Number> easting, northing, upward;
    Array<Byte> tile, flag;
    Array<Colour> colour;
};

template <class Number>
using TiledOut = Tiled<Number, std::uint8_t, std::uint32_t>;
template <class Number>
using TiledIn = Tiled<const Number, const std::uint8_t, const std::uint32_t>;

// The window of blocks around some points, from the south-west one.
struct BlockWindow {
    double tile_size;
    Index first_col, first_row, cols;

    Index cell(Index col, Index row) const {
        return (floor_divide(row, block_tiles) - first_row) * cols + floor_divide(col, block_tiles) - first_col;
    }
};

std::uint8_t tile_of_block(Index col, Index row) {
    return static_cast<std::uint8_t>(modulo(row, block_tiles) * block_tiles + modulo(col, block_tiles));
}

// Fills the block of the window and the tile in it of each point, and counts the points of each block.
void count_points(
    Coordinates<double> points, BlockWindow window, Array<Index> counts, Array<std::int32_t> cells,
    Array<std::uint8_t> tiles) {
    for (Index i = 0; i < points.easting.size(); ++i) {
        const Index col = tile_index(points.easting[i], window.tile_size);
        const Index row = tile_index(points.northing[i], window.tile_size);
        const Index cell = window.cell(col, row);
        cells[i] = static_cast<std::int32_t>(cell);
        tiles[i] = tile_of_block(col, row);
        ++counts[cell + 1];
    }
}

// Points of a file's own grid: by where the columns and rows of tiles begin on it, from the tile `first` on, without
// coordinates.
void count_scaled_points(
    Coordinates<std::int32_t> points, Array<const Index> cols, Array<const Index> rows, Array<const Index> first,
    BlockWindow window, Array<Index> counts, Array<std::int32_t> cells, Array<std::uint8_t> tiles) {
    const auto interval_of = [](Index number, Array<const Index> borders) {
        const Index last = borders.size() - 1;  // intervals are about as wide as each other
        const auto part = static_cast<double>(number - borders[0]) / static_cast<double>(borders[last] - borders[0]);
        Index i = std::min(static_cast<Index>(part * static_cast<double>(last)), last - 1);
        while (number < borders[i]) --i;
        while (number >= borders[i + 1]) ++i;
        return i;
    };
    Index x_first = 0, x_end = 0, y_first = 0, y_end = 0;  // of the tile of the point before
    Index cell = 0, run = 0;
    std::uint8_t tile = 0;
    for (Index i = 0; i < points.easting.size(); ++i) {
        const Index x = points.easting[i], y = points.northing[i];
        // Neighbours in a file are neighbours on the ground.
        if (!(x_first <= x && x < x_end && y_first <= y && y < y_end)) {
            counts[cell + 1] += run;
            run = 0;
            const Index col = interval_of(x, cols), row = interval_of(y, rows);
            x_first = cols[col];
            x_end = cols[col + 1];
            y_first = rows[row];
            y_end = rows[row + 1];
            cell = window.cell(first[0] + col, first[1] + row);
            tile = tile_of_block(first[0] + col, first[1] + row);
        }
        ++run;
        cells[i] = static_cast<std::int32_t>(cell);
        tiles[i] = tile;
    }
    counts[cell + 1] += run;
}

// Puts points block by block, in their own order inside a block; `place` is where each block's next point goes.
template <class Number>
void scatter(
    Coordinates<Number> points, Array<const std::uint8_t> flag, Array<const std::uint32_t> colour,
    Array<const std::int32_t> cells, Array<const std::uint8_t> tiles, Array<Index> place, TiledOut<Number> out) {
    for (Index i = 0; i < flag.size(); ++i) {
        const Index p = place[cells[i]]++;
        out.easting[p] = points.easting[i];
        out.northing[p] = points.northing[i];
        out.upward[p] = points.upward[i];
        out.tile[p] = tiles[i];
        out.flag[p] = flag[i];
        if (colour.size() > 0) out.colour[p] = colour[i];
    }
}

// ---- The points of a block, tile by tile ----

struct Marked {
    Array<double> easting, northing, upward;
    Array<std::uint8_t> flag;
};

// The picture of a block that points are painted on: column and row of its south-west tile, and of each pixel the
// height and the colour of the point that it shows; -inf and 0: none.
struct BlockPhoto {
    Array<const Index> corner;
    double tile_size;
    Index pixels;
    Array<double> height;
    Array<std::uint32_t> colour;
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

// Puts points tile by tile, in metres; `following` is where each tile's next point goes. Points with a colour are
// painted. `numbers` of a `Scaling`.
template <class Number>
void place(TiledIn<Number> points, Array<const double> numbers, Array<Index> following, Marked out, BlockPhoto photo) {
    const Scaling scaling{numbers};
    for (Index i = 0; i < points.tile.size(); ++i) {
        const Index tile = points.tile[i];
        const Index p = following[tile]++;
        const std::array<double, 3> point{
            scaling.metres(points.easting[i], 0), scaling.metres(points.northing[i], 1),
            scaling.metres(points.upward[i], 2)};
        out.easting[p] = point[0];
        out.northing[p] = point[1];
        out.upward[p] = point[2];
        out.flag[p] = points.flag[i];
        if (points.colour.size() > 0 && points.colour[i] != 0) paint(point, tile, points.colour[i], photo);
    }
}

// ---- The points of a tile in their order ----

// The points of a tile: their keys; where the points of each bucket begin; the points in order, and their keys.
struct SortScratch {
    explicit SortScratch(Index most) : key(most), order(most), rank(most) {}

    std::vector<std::uint64_t> key;
    std::vector<std::int32_t> order, bucket;
    std::vector<std::uint64_t> rank;
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
void fill_keys(
    Index count, double west, double south, double size, const Marked& tile, std::vector<std::uint64_t>& key) {
    const double low = *std::min_element(tile.upward.begin(), tile.upward.begin() + count);
    for (Index j = 0; j < count; ++j) {
        const double x = from_middle(tile.easting[j], west, size), y = from_middle(tile.northing[j], south, size);
        const double z = std::rint((tile.upward[j] - low) * hash_steps);
        key[j] = hash_point(std::min(x, y), std::max(x, y), z) >> (64 - key_bits);
    }
}

// Puts the first points of the tile into `order` by the leading bits of their keys.
void fill_buckets(Index count, SortScratch& scratch) {
    const int width = std::max(1, static_cast<int>(std::bit_width(static_cast<std::uint64_t>(count - 1))));
    const Index buckets = Index{1} << width;
    const auto bucket_of = [&](Index j) { return static_cast<Index>(scratch.key[j] >> (key_bits - width)); };
    scratch.bucket.assign(buckets + 1, 0);
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
void insert_by_key(
    const Marked& points, Index count, std::vector<std::int32_t>& order, std::vector<std::uint64_t>& rank) {
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
void sort_tiles(Array<const Index> first, Array<Index> starts, Array<const Index> corner, double size, Marked points) {
    Index most = 0, kept = 0;
    for (Index t = 0; t < tiles_of_block; ++t) most = std::max(most, first[t + 1] - first[t]);
    std::vector<double> easting(most), northing(most), upward(most);
    std::vector<std::uint8_t> flag(most);
    const Marked tile{view(easting), view(northing), view(upward), view(flag)};
    SortScratch scratch(most);
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
BUMPY_RECORD(bumpy::TiledOut<double>, easting, northing, upward, tile, flag, colour)
BUMPY_RECORD(bumpy::TiledOut<std::int32_t>, easting, northing, upward, tile, flag, colour)
BUMPY_RECORD(bumpy::TiledIn<double>, easting, northing, upward, tile, flag, colour)
BUMPY_RECORD(bumpy::TiledIn<std::int32_t>, easting, northing, upward, tile, flag, colour)
BUMPY_RECORD(bumpy::BlockWindow, tile_size, first_col, first_row, cols)
BUMPY_RECORD(bumpy::Marked, easting, northing, upward, flag)
BUMPY_RECORD(bumpy::BlockPhoto, corner, tile_size, pixels, height, colour)

void bind_grouping(nb::module_& module) {
    using namespace bumpy;
    BUMPY_LOOP(module, count_points);
    BUMPY_LOOP(module, count_scaled_points);
    module.def("scatter_points", &scatter<double>, free_interpreter());
    module.def("scatter_scaled_points", &scatter<std::int32_t>, free_interpreter());
    BUMPY_LOOP(module, count_tiles);
    module.def("place_points", &place<double>, free_interpreter());
    module.def("place_scaled_points", &place<std::int32_t>, free_interpreter());
    BUMPY_LOOP(module, sort_tiles);
}
