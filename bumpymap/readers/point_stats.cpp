// Sums the points of each flight line in each cell of a grid, from which heights of lines are compared; see
// point_stats.py. The sums are integers of 0.1 mm, so that they do not depend on the order of the points. Sums that
// exceed 64 bits wrap around; differences of them are right again. Cells are kept in a hash table with open addresses.
#include "bumpytiles/bindings.hpp"
#include "bumpytiles/grouping.hpp"

namespace bumpy {
namespace {

// Kind of a point that is ground: POINT_GROUND in core/types.py.
constexpr std::uint8_t ground_kind = 1;
// Points of no flight line: neither they nor their file have a source id. Clouds of photogrammetry have such alone.
constexpr std::uint16_t no_line = 0;
// Side of a cell, m.
constexpr double cell_m = 3.0;
// Steps of a coordinate in a metre.
constexpr double steps_of_metre = 1e4;
// Number of points, x, y, z, x x, x y, y y, x z, y z, z z.
constexpr int sums_of_cell = 10;
// Rows of a table, a power of two, and how many of them are filled.
constexpr int row_bits = 13;
constexpr Index rows_of_table = Index{1} << row_bits;
constexpr Index most_rows = rows_of_table * 3 / 4;
// Bits of a key: column and row of the cell, unique within 25,000 km; line number and ground flag.
constexpr int axis_bits = 23;
constexpr int line_bits = 17;

template <class Number>
struct LinedPoints {
    Array<const Number> x, y, z;
    Array<const std::uint8_t> kind;
    Array<const std::uint16_t> line;
};

// A hash table of the cells of flight lines. Its state: the next point to add, and the rows in use.
struct CellTable {
    Array<Index> keys;
    Array<Index, 2> sums;
    Array<Index> state;
};

std::uint64_t key_of(Index col, Index row, Index line, bool ground) {
    constexpr std::uint64_t mask = (1U << axis_bits) - 1;
    return (static_cast<std::uint64_t>(col) & mask) << (axis_bits + line_bits) |
           (static_cast<std::uint64_t>(row) & mask) << line_bits | static_cast<std::uint64_t>(line) << 1 | ground;
}

// The row of a key, which is added if it is new.
Index row_of(std::uint64_t key, CellTable& table) {
    auto row = static_cast<Index>((key * 0x9E3779B97F4A7C15U) >> (64 - row_bits));
    while (table.keys[row] != static_cast<Index>(key)) {
        if (table.keys[row] == -1) {
            table.keys[row] = static_cast<Index>(key);
            ++table.state[1];
            break;
        }
        row = (row + 1) & (rows_of_table - 1);
    }
    return row;
}

std::uint64_t steps(double metres) {
    return static_cast<std::uint64_t>(static_cast<Index>(std::rint(metres * steps_of_metre)));
}

// Adds points, from the one that `state` names, until all are added or the table is full. Neighbours in a file are
// neighbours on the ground: sums of points in one cell are added up before they are stored.
// `numbers` of a `Scaling`.
template <class Number>
void add(
    LinedPoints<Number> points, Array<const double> numbers, Array<Index> keys, Array<Index, 2> cells,
    Array<Index> state) {
    CellTable table{keys, cells, state};
    const Scaling scaling{numbers};
    const Index n = points.x.size();
    Index i = table.state[0];
    while (i < n && table.state[1] < most_rows) {
        const std::uint16_t line = points.line[i];
        if (line == no_line) {
            ++i;
            continue;
        }
        const bool ground = points.kind[i] == ground_kind;
        double x = scaling.metres(points.x[i], 0), y = scaling.metres(points.y[i], 1);
        const Index col = tile_index(x, cell_m), row = tile_index(y, cell_m);
        const double west = static_cast<double>(col) * cell_m, south = static_cast<double>(row) * cell_m;
        const double east = static_cast<double>(col + 1) * cell_m, north = static_cast<double>(row + 1) * cell_m;
        std::array<std::uint64_t, sums_of_cell> sums{};
        do {
            const std::uint64_t e = steps(x - west), u = steps(scaling.metres(points.z[i], 2)), m = steps(y - south);
            const std::array<std::uint64_t, sums_of_cell> own{1, e, m, u, e * e, e * m, m * m, e * u, m * u, u * u};
            for (std::size_t k = 0; k < own.size(); ++k) sums[k] += own[k];
            if (++i == n) break;
            x = scaling.metres(points.x[i], 0);
            y = scaling.metres(points.y[i], 1);
        } while (points.line[i] == line && (points.kind[i] == ground_kind) == ground && west <= x && x < east &&
                 south <= y && y < north);
        const Array<Index> stored = table.sums.at(row_of(key_of(col, row, line, ground), table));
        for (std::size_t k = 0; k < sums.size(); ++k) {
            Index& sum = stored[static_cast<Index>(k)];
            sum = static_cast<Index>(static_cast<std::uint64_t>(sum) + sums[k]);
        }
    }
    table.state[0] = i;
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::LinedPoints<double>, x, y, z, kind, line)
BUMPY_RECORD(bumpy::LinedPoints<std::int32_t>, x, y, z, kind, line)

void bind_point_stats(nb::module_& module) {
    using namespace bumpy;
    module.attr("AXIS_BITS") = axis_bits;
    module.attr("LINE_BITS") = line_bits;
    module.attr("SLOTS") = rows_of_table;
    module.attr("SUMS") = sums_of_cell;
    module.def("add_points", &add<double>, free_interpreter());
    module.def("add_scaled_points", &add<std::int32_t>, free_interpreter());
}
