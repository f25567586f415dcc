// Watches LAS point records: drops those that are withheld or noise, notes the extent of all and how many lie outside
// the bounds of the file, and appends those that count, as integers of the file's own grid. Records are held to LAS 1.4
// R15, tables 7 and 10; see las.py.
#include <algorithm>

#include "bumpytiles/bindings.hpp"

namespace bumpy {
namespace {

using Records = Array<const std::uint8_t, 2>;

struct LinedPoints {
    Array<std::int32_t> x, y, z;
    Array<std::uint8_t> kind;
    Array<std::uint16_t> line;
};

// A record, read by its layout: byte and mask of the class, byte and mask of the withheld flag; first byte of the
// flight line, and the line of points where that is 0.
struct Record {
    const std::uint8_t* bytes;
    const Index* layout;

    std::uint32_t word(Index at) const { return short_word(at) | short_word(at + 2) << 16; }
    std::uint32_t short_word(Index at) const { return bytes[at] | static_cast<std::uint32_t>(bytes[at + 1]) << 8; }
    std::int32_t axis(Index number) const { return static_cast<std::int32_t>(word(4 * number)); }
    Index code() const { return bytes[layout[0]] & layout[1]; }
    bool withheld() const { return (bytes[layout[2]] & layout[3]) != 0; }
    bool noise() const { return code() == 7 || code() == 18; }
    Index line() const {
        const Index own = short_word(layout[4]);
        return own != 0 ? own : layout[5];
    }
};

// Colours of the records that count, 3 x 16 bits from byte `at`, shifted to 8 bits each.
void read_colours(Records records, Array<const Index> layout, Index at, Index shift, Array<std::uint32_t> out) {
    Index to = 0;
    for (Index i = 0; i < records.shape[0]; ++i) {
        const Record record{&records(i, 0), layout.data};
        if (record.withheld() || record.noise()) continue;
        std::uint32_t colour = 0;
        for (Index band = 0; band < 3; ++band)
            colour = colour << 8 | std::min(record.short_word(at + 2 * band) >> shift, 255U);
        out[to++] = colour;
    }
}

// `box`: lowest and highest x, then y, in the bounds of the file; `kinds` of the classes. `extremes`, lowest and
// highest x, y and z, and `counts`, of points that are withheld, noise, outside and kept, are updated.
void filter_records(
    Records records, Array<const Index> layout, Array<const Index> box, Array<const std::uint8_t> kinds,
    LinedPoints out, Array<Index> extremes, Array<Index> counts) {
    Index withheld = 0, noise = 0, outside = 0, to = counts[3];
    std::array<std::int32_t, 3> low{}, high{};
    for (std::size_t axis = 0; axis < 3; ++axis) {
        low[axis] = static_cast<std::int32_t>(extremes[static_cast<Index>(2 * axis)]);
        high[axis] = static_cast<std::int32_t>(extremes[static_cast<Index>(2 * axis + 1)]);
    }
    for (Index i = 0; i < records.shape[0]; ++i) {
        const Record record{&records(i, 0), layout.data};
        const std::array<std::int32_t, 3> place{record.axis(0), record.axis(1), record.axis(2)};
        for (std::size_t axis = 0; axis < 3; ++axis) {
            low[axis] = std::min(low[axis], place[axis]);
            high[axis] = std::max(high[axis], place[axis]);
        }
        outside += !(box[0] <= place[0] && place[0] <= box[1] && box[2] <= place[1] && place[1] <= box[3]);
        if (record.withheld()) {
            ++withheld;
        } else if (record.noise()) {
            ++noise;
        } else {
            out.x[to] = place[0];
            out.y[to] = place[1];
            out.z[to] = place[2];
            out.kind[to] = kinds[record.code()];
            out.line[to] = static_cast<std::uint16_t>(record.line());
            ++to;
        }
    }
    for (std::size_t axis = 0; axis < 3; ++axis) {
        extremes[static_cast<Index>(2 * axis)] = low[axis];
        extremes[static_cast<Index>(2 * axis + 1)] = high[axis];
    }
    counts[0] += withheld;
    counts[1] += noise;
    counts[2] += outside;
    counts[3] = to;
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::LinedPoints, x, y, z, kind, line)

BUMPY_LOOPS(las, read_colours, filter_records)
