// Gathers the points of frame after frame in voxels, which are found by a hash of their key (open addressing).
//
// Of ground a voxel keeps a pseudo-random sample, by a hash of the place in the voxel, in plan: the points nearest to
// the sensor would lie at the edge of the pixel, and some from each of two voxels, one above the other, would pull the
// ground to the border between them. Of others it keeps one of each frame before a second of any, those nearest to the
// sensor, the first frame's of equals. The caller sees to it that the table has room. Ours; see merge.py for the
// arrays.
#include "bumpytiles/bindings.hpp"
#include "bumpytiles/grouping.hpp"

namespace bumpy {
namespace {

struct VoxelTable {
    Array<std::int32_t> slot;
    Array<Index> key;
    Array<std::int32_t> hits, last, mine, held;
    Array<std::uint32_t, 2> turn;
    Array<std::int32_t, 3> place;
    Array<std::int32_t> size;
};

// The slot that holds a key, or the free one where it goes.
Index slot_of(const VoxelTable& table, Index key) {
    const auto mask = static_cast<std::uint64_t>(table.slot.size() - 1);
    const std::uint64_t spread = static_cast<std::uint64_t>(key ^ (key >> 29)) * 0x1CE4E5B9BF58476DU;
    std::uint64_t at = (spread ^ (spread >> 32)) & mask;
    const auto row = [&] { return table.slot[static_cast<Index>(at)]; };
    while (row() >= 0 && table.key[row()] != key) at = (at + 1) & mask;
    return static_cast<Index>(at);
}

// The row of a voxel; a new one gets the next.
Index row_of(const VoxelTable& table, Index key) {
    std::int32_t& row = table.slot[slot_of(table, key)];
    if (row < 0) {
        row = table.size[0]++;
        table.key[row] = key;
        table.hits[row] = table.held[row] = 0;
        table.last[row] = -1;
    }
    return row;
}

// The hash of a place in a voxel, in plan, mm; constants of SplitMix64.
std::uint32_t hash_of(Index x, Index y) {
    std::uint64_t bits = (static_cast<std::uint64_t>(y) << 32U) | static_cast<std::uint64_t>(x);
    bits = (bits ^ (bits >> 30U)) * 0xBF58476D1CE4E5B9U;
    bits = (bits ^ (bits >> 27U)) * 0x94D049BB133111EBU;
    return static_cast<std::uint32_t>(bits >> 32U);
}

// Adds points of a frame to their voxels.
//
// `place` (points, 3): mm; x and y count from the corner of the block; `range_cm` (points,): distance from the sensor,
// cm; `kind` (points,): 1 for ground, 0 for others: they have voxels of their own; `frame`: its number; `voxel_mm`:
// edge of a voxel; `table`: has a free row and two free slots for every point.
void gather_points(
    Array<const std::int32_t, 2> place, Array<const std::uint16_t> range_cm, Array<const std::uint8_t> kind,
    std::int32_t frame, Index voxel_mm, VoxelTable table) {
    const auto most = static_cast<std::int32_t>(table.turn.shape[1]);
    for (Index i = 0; i < place.shape[0]; ++i) {
        const auto voxel = [&](Index axis) { return floor_divide(place(i, axis), voxel_mm); };
        const auto inside = [&](Index axis) { return place(i, axis) - voxel(axis) * voxel_mm; };
        const Index key = ((voxel(2) * 4096 + voxel(1)) * 4096 + voxel(0)) * 2 + kind[i];
        const Index at = row_of(table, key);
        if (table.last[at] != frame) {
            table.last[at] = frame;
            ++table.hits[at];
            table.mine[at] = 0;
        }
        if (kind[i] == 0 && table.mine[at] == most) continue;
        const std::uint32_t turn = kind[i] != 0 ? hash_of(inside(0), inside(1))
                                                : static_cast<std::uint32_t>(table.mine[at]++ * 65'536 + range_cm[i]);
        const std::int32_t held = table.held[at];
        if (held == most && turn >= table.turn(at, most - 1)) continue;
        Index to = held < most ? held : most - 1;
        for (; to > 0 && turn < table.turn(at, to - 1); --to) {
            table.turn(at, to) = table.turn(at, to - 1);
            for (Index axis = 0; axis < 3; ++axis) table.place(at, to, axis) = table.place(at, to - 1, axis);
        }
        table.turn(at, to) = turn;
        for (Index axis = 0; axis < 3; ++axis) table.place(at, to, axis) = place(i, axis);
        if (held < most) table.held[at] = held + 1;
    }
}

// Enters the rows of a table, copied to a larger one, into the slots of that; its slots come free.
void move_voxels(VoxelTable table, VoxelTable larger) {
    for (std::int32_t row = 0; row < table.size[0]; ++row) larger.slot[slot_of(larger, larger.key[row])] = row;
    larger.size[0] = table.size[0];
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::VoxelTable, slot, key, hits, last, mine, held, turn, place, size)

BUMPY_LOOPS(merge, gather_points, move_voxels)
