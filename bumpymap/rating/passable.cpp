// The ways that lead through each tile, and how the free areas of tiles join. Free pixels that hang together are found
// by flooding, tile by tile. And the nearest marked pixel of each. Ours; see passable.py and steps.py for the arrays.
#include <algorithm>
#include <bit>
#include <numeric>
#include <vector>

#include "bumpytiles/bindings.hpp"

namespace bumpy {
namespace {

using Byte = std::uint8_t;

// States of a pixel, as bumpymap.core defines them.
constexpr Byte obstacle = 1, step_edge = 8, unseen = 255;
// In the place of the number of an area: free, and not numbered yet.
constexpr Byte not_numbered = 255;
constexpr Byte most_areas = 254;
// Bits of the sides of a tile.
constexpr unsigned north = 1, east = 2, south = 4, west = 8;

// Pixels of a tile, in an array of its own or in a mosaic.
struct Tile {
    Byte* first;
    Index size, stride;

    Byte& operator()(Index row, Index col) const { return first[row * stride + col]; }
};

bool is_taken(Byte state) { return (state == obstacle) | (state == unseen) | (state == step_edge); }

// ---- Areas of a tile ----

struct Place {
    Index row, col;
};

struct Area {
    Index count = 0;
    unsigned sides = 0;  // of the tile, that it touches
};

// Gives the pixels of a tile that are as one of them, and hang together with it, another value.
Area flood(Tile cells, Place start, Byte value, bool corners) {
    constexpr Place beside[] = {{-1, 0}, {0, 1}, {1, 0}, {0, -1}, {1, 1}, {-1, 1}, {1, -1}, {-1, -1}};
    const Index last = cells.size - 1, neighbours = corners ? 8 : 4;
    const Byte before = cells(start.row, start.col);
    Area area;
    std::vector<Place> waiting;
    waiting.reserve(cells.size * cells.size);
    waiting.push_back(start);
    cells(start.row, start.col) = value;
    while (!waiting.empty()) {
        const auto [r, c] = waiting.back();
        waiting.pop_back();
        ++area.count;
        area.sides |= (r == 0 ? north : 0) | (r == last ? south : 0) | (c == 0 ? west : 0) | (c == last ? east : 0);
        for (Index k = 0; k < neighbours; ++k) {
            const Index row = r + beside[k].row, col = c + beside[k].col;
            if (row < 0 || row > last || col < 0 || col > last || cells(row, col) != before) continue;
            cells(row, col) = value;
            waiting.push_back({row, col});
        }
    }
    return area;
}

// Gives the areas of a tile numbers; its free pixels have the number `not_numbered`, the others 0.
void number_tile(Tile areas, bool corners) {
    Byte *const begin = areas.first, *const end = begin + areas.size * areas.size;
    if (std::find(begin, end, 0) == end) {  // one area
        std::fill(begin, end, Byte{1});
        return;
    }
    std::array<Index, most_areas + 1> sizes{};
    Byte found = 0;
    for (Index r = 0; r < areas.size; ++r) {
        for (Index c = 0; c < areas.size; ++c) {
            if (areas(r, c) != not_numbered) continue;
            if (found < most_areas) ++found;
            sizes[found] = flood(areas, {r, c}, found, corners).count;
        }
    }
    const auto first = static_cast<Byte>(std::max_element(sizes.begin() + 1, sizes.end()) - sizes.begin());
    if (first == 1) return;
    std::array<Byte, most_areas + 1> number;
    std::iota(number.begin(), number.end(), Byte{0});
    std::swap(number[1], number[first]);
    std::transform(begin, end, begin, [&](Byte area) { return number[area]; });
}

// Gives the areas of free pixels of every tile numbers from 1, the largest (of equal ones the northernmost), or 0. Of
// more than 254 areas, the last share a number.
void number_areas(Array<const Byte, 4> free, bool corners, Array<Byte, 4> areas) {
    const Index size = free.shape[2];
    std::transform(
        free.data, free.data + free.count(), areas.data, [](Byte is_free) { return is_free ? not_numbered : Byte{0}; });
    for (Index k = 0; k < free.count(); k += size * size) number_tile({areas.data + k, size, size}, corners);
}

// ---- Ways through tiles ----

// Fills, for wanted inner tiles, if there is a way through them, and if there would be none if every edge could be
// crossed: `edges` (tiles - 2, tiles - 2, 4), north, east, south, west. `mask` is not 0 where the middle of the vehicle
// cannot be; it is changed.
void find_ways(
    Array<const Byte, 2> objects, Array<Byte, 2> mask, Array<const bool, 3> edges, Array<const bool, 2> wanted,
    bool corners, Array<bool, 2> passable, Array<bool, 2> blocked) {
    const Index pixels = objects.shape[0] / (wanted.shape[0] + 2);
    for (Index k = 0; k < wanted.count(); ++k) {
        if (!wanted.data[k]) continue;
        const Index row = k / wanted.shape[1], col = k % wanted.shape[1];
        const Index top = (row + 1) * pixels, left = (col + 1) * pixels;
        const Tile grown{&mask(top, left), pixels, mask.shape[1]};
        unsigned usable = 0;
        for (Index edge = 0; edge < 4; ++edge) usable |= edges(row, col, edge) ? 1U << edge : 0;
        bool is_empty = true, is_free = true;
        for (Index r = 0; r < pixels; ++r) {
            for (Index c = 0; c < pixels; ++c) {
                is_empty &= !is_taken(objects(top + r, left + c));
                is_free &= grown(r, c) == 0;
            }
        }
        const int least = is_empty ? 1 : 2;
        passable(row, col) = is_free && std::popcount(usable) >= least;
        blocked(row, col) = !is_free;
        for (Index r = 0; !is_free && r < pixels; ++r) {
            for (Index c = 0; c < pixels; ++c) {
                if (grown(r, c) != 0) continue;
                const unsigned sides = flood(grown, {r, c}, 2, corners).sides;
                passable(row, col) |= std::popcount(sides & usable) >= least;
                blocked(row, col) &= std::popcount(sides) < least;
            }
        }
    }
}

// ---- Areas of neighbouring tiles ----

// The areas of tiles side by side.
struct Areas {
    Array<const Byte, 4> number;
    bool corners;

    Array<const Byte, 2> tile(Place at) const { return number.at(at.row).at(at.col); }

    // True if areas of two tiles, side by side, touch across their border.
    bool touch(Place a, int one, Place b, int other) const {
        const Index last = number.shape[2] - 1, wide = corners ? 1 : 0;
        const auto at_border = [&](Place from, Place to, Index k) {
            const Index row = to.row == from.row ? k : (to.row > from.row ? last : 0);
            const Index col = to.col == from.col ? k : (to.col > from.col ? last : 0);
            return tile(from)(row, col);
        };
        for (Index k = 0; k <= last; ++k) {
            if (at_border(a, b, k) != one) continue;
            for (Index m = std::max(Index{0}, k - wide); m <= std::min(last, k + wide); ++m) {
                if (at_border(b, a, m) == other) return true;
            }
        }
        return false;
    }

    // True if an area of the tile beside two others, which lie diagonally, touches the first areas of both.
    bool join_over(Place between, Place upper, Place lower) const {
        const Array<const Byte, 2> areas = tile(between);
        const Byte most = *std::max_element(areas.data, areas.data + areas.count());
        for (int area = 1; area <= most; ++area) {
            if (touch(upper, 1, between, area) && touch(between, area, lower, 1)) return true;
        }
        return false;
    }

    // True if the first areas of two tiles, of which the first is not the southern one, are joined.
    bool join(Place upper, Place lower) const {
        if (upper.row == lower.row || upper.col == lower.col) return touch(upper, 1, lower, 1);
        const Index last = number.shape[2] - 1;
        const bool is_east = lower.col > upper.col;
        return (corners && tile(upper)(last, is_east ? last : 0) == 1 && tile(lower)(0, is_east ? 0 : last) == 1) ||
               join_over({lower.row, upper.col}, upper, lower) || join_over({upper.row, lower.col}, upper, lower);
    }
};

// Marks the tiles to close so that the largest areas of any two passable tiles that touch are joined.
//
// Of two tiles side by side whose largest areas do not touch, the one with the smaller area is closed (of equal ones
// the southern or eastern). So it is with two tiles that touch at a corner, unless an area of one of the two tiles
// beside them joins both.
void close_split(
    Array<const Byte, 4> areas, Array<const std::int32_t, 2> largest, Array<const bool, 2> passable, bool corners,
    Array<bool, 2> split) {
    constexpr Place beside[] = {{0, 1}, {1, 0}, {1, 1}, {1, -1}};
    const Areas tiles{areas, corners};
    for (Index r = 0; r < passable.shape[0]; ++r) {
        for (Index c = 0; c < passable.shape[1]; ++c) {
            if (!passable(r, c)) continue;
            for (const auto& [down, right] : beside) {
                const Index row = r + down, col = c + right;
                if (row >= passable.shape[0] || col < 0 || col >= passable.shape[1] || !passable(row, col)) continue;
                if (tiles.join({r, c}, {row, col})) continue;
                const bool is_smaller = largest(r, c) < largest(row, col);
                (is_smaller ? split(r, c) : split(row, col)) = true;
            }
        }
    }
}

// Fills place and squared distance, px, of the nearest marked pixel of the same tile: its row times the pixels of a
// side, and its column; of those as near, the westernmost, then the northernmost. -1 in tiles without any. All are
// (tiles, pixels, pixels).
void find_nearest(Array<const bool, 3> marks, Array<std::int32_t, 3> nearest, Array<std::int32_t, 3> squares) {
    const auto size = static_cast<std::int32_t>(marks.shape[1]);
    std::vector<std::int32_t> row_of(marks.shape[1] * marks.shape[1]);  // the nearest mark in the column; -1: none
    for (Index t = 0; t < marks.shape[0]; ++t) {
        const Array<const bool, 2> tile = marks.at(t);
        for (std::int32_t c = 0; c < size; ++c) {
            for (std::int32_t r = 0, last = -1; r < size; ++r) {
                if (tile(r, c)) last = r;
                row_of[r * size + c] = last;
            }
            for (std::int32_t r = size - 1, next = -1; r >= 0; --r) {
                std::int32_t& own = row_of[r * size + c];
                if (own == r) next = r;
                if (next >= 0 && (own < 0 || next - r < r - own)) own = next;
            }
        }
        for (std::int32_t r = 0; r < size; ++r) {
            for (std::int32_t c = 0; c < size; ++c) {
                std::int32_t found = -1, least = -1;
                for (std::int32_t col = 0; col < size; ++col) {
                    const std::int32_t row = row_of[r * size + col];
                    const std::int32_t square = (row - r) * (row - r) + (col - c) * (col - c);
                    if (row < 0 || (found >= 0 && square >= least)) continue;
                    found = row * size + col;
                    least = square;
                }
                nearest(t, r, c) = found;
                squares(t, r, c) = least;
            }
        }
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_LOOPS(passable, find_ways, number_areas, close_split, find_nearest)
