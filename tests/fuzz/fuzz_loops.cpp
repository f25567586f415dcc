// Feeds bytes that no writer wrote to the loops whose arrays come from files: LAS records, the points of a tile pack,
// and frames of a scan (`make fuzz`). What Python refuses before a loop sees it is left out: numbers that are not
// finite.
#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstring>
#include <span>
#include <vector>

#include "bumpytiles/bindings.hpp"

// Bindings are not built, so that Python need not be linked.
static void bind_align(nb::module_&), bind_grouping(nb::module_&), bind_las(nb::module_&);
static void bind_point_stats(nb::module_&), bind_sectors(nb::module_&);

#include "bumpymap/readers/las.cpp"
#include "bumpymap/scan/align.cpp"
#define LinedPoints StatPoints  // las.cpp has its own
#include "bumpymap/readers/point_stats.cpp"
#include "bumpymap/scan/sectors.cpp"
#include "bumpymap/scan/surface.cpp"
#include "tiles/bumpytiles/grouping.cpp"

using namespace bumpy;
using Bytes = std::span<const std::uint8_t>;

// An array with memory of its own.
template <class T>
struct Column : std::vector<T> {
    using std::vector<T>::vector;
    explicit Column(std::integral auto n, T value = {}) : std::vector<T>(static_cast<std::size_t>(n), value) {}
    operator Array<T>() { return {this->data(), {std::ssize(*this)}}; }
    operator Array<const T>() const { return {this->data(), {std::ssize(*this)}}; }
};

// The next `n` values, and zeros behind the end; numbers that are not finite become 0.
template <class T>
Column<T> take(Bytes& bytes, Index n) {
    Column<T> out(n);
    const std::size_t size = std::min(bytes.size(), out.size() * sizeof(T));
    if (size > 0) std::memcpy(out.data(), bytes.data(), size);
    bytes = bytes.subspan(size);
    for (T& value : out)
        if constexpr (std::is_floating_point_v<T>) value = std::isfinite(value) ? value : T{0};
    return out;
}

void fuzz_records(bool layered, Bytes bytes) {  // layered: point formats 6 to 10
    const Index width = layered ? 36 : 26, n = std::ssize(bytes) / width;
    const Column<Index> layout = layered ? Column<Index>{16, 255, 15, 4, 20, 7} : Column<Index>{15, 31, 15, 128, 18, 7};
    const Column<Index> box{-1000, 1000, -1000, 1000};
    Column<Index> extremes{INT32_MAX, INT32_MIN, INT32_MAX, INT32_MIN, INT32_MAX, INT32_MIN}, counts(4), state(2);
    const Column<std::uint8_t> kinds(256, 1);
    Column<std::int32_t> x(n), y(n), z(n);
    Column<std::uint8_t> kind(n);
    Column<std::uint16_t> line(n);
    Column<std::uint32_t> colour(n);
    read_colours({bytes.data(), {n, width}}, layout, width - 6, 8, colour);
    filter_records({bytes.data(), {n, width}}, layout, box, kinds, {x, y, z, kind, line}, extremes, counts);
    const auto kept = static_cast<std::size_t>(counts[3]);
    for (auto* axis : {&x, &y, &z}) axis->resize(kept);
    const Column<double> scaling{1e-3, 1e-3, 1e-3, 5e5, 5e6, 0.0, 1.0, 1.0, 1.0};
    while (state[0] < counts[3]) {
        Column<Index> keys(rows_of_table, -1), sums(rows_of_table * sums_of_cell);
        state[1] = 0;
        add<std::int32_t>({x, y, z, kind, line}, scaling, keys, {sums.data(), {rows_of_table, sums_of_cell}}, state);
    }
}

void fuzz_pack(Bytes bytes) {
    const Index n = std::ssize(bytes) / 30;
    const auto x = take<double>(bytes, n), y = take<double>(bytes, n), z = take<double>(bytes, n);
    const auto tile = take<std::uint8_t>(bytes, n), flag = take<std::uint8_t>(bytes, n);
    const auto colour = take<std::uint32_t>(bytes, n);
    Column<Index> first(257), starts(257);
    count_tiles(tile, first);
    for (std::size_t t = 1; t < first.size(); ++t) first[t] += first[t - 1];
    Column<Index> following(first);
    Column<double> east(n), north(n), up(n), height(256 * 16, -1e300);
    Column<std::uint8_t> flags(n);
    Column<std::uint32_t> shown(256 * 16);
    const Column<Index> corner{-16, 32};
    const Marked out{east, north, up, flags};
    place<double>({x, y, z, tile, flag, colour}, {}, following, out, {corner, 1.0, 4, height, shown});
    sort_tiles(first, starts, corner, 1.0, out);
}

void fuzz_frame(Bytes bytes) {
    const Index n = std::ssize(bytes) / 12;
    const auto values = take<float>(bytes, 3 * n);
    const Array<const float, 2> points{values.data(), {n, 3}};
    const Column<double> edges{0.5, 4.0, 20.0};
    const Column<Index> sectors{4, 8}, rings{2, 3};
    const ZoneGrid grid{edges, sectors, rings, 0.25};
    const Index room = 33, bins = count_bins(grid);
    Column<double> measures(7 * room), origin(1);
    Column<std::int16_t> zone(room), ring(room), around(room);
    Column<std::int32_t> count(room), ground(room), obstacles(room), overhead(room), sector(n, -1);
    Column<float> normal(3 * room), heights(16 * room), objects(32 * room), places(8 * bins), height(n);
    Column<float> coverage(room), variance(room), residual(room), top(room), clearance(room);
    Column<std::uint16_t> place(2 * n);
    std::vector<std::uint8_t> flags(static_cast<std::size_t>(2 * room + 2 * n));
    const auto flag = [&](Index begin, Index size) {
        return Array<bool>{reinterpret_cast<bool*>(flags.data()) + begin, {size}};
    };
    find_sectors(
        points, grid, {4, 5, 0.7, 2.0, 0.25, 1.4},
        {zone,
         ring,
         around,
         count,
         ground,
         obstacles,
         overhead,
         flag(0, room),
         flag(room, room),
         {normal.data(), {room, 3}},
         {heights.data(), {room, 4, 4}},
         coverage,
         variance,
         residual,
         top,
         clearance,
         {objects.data(), {room, 2, 4, 4}},
         {measures.data(), {room, 7}}},
        {{place.data(), {n, 2}},
         sector,
         flag(2 * room, n),
         flag(2 * room + n, n),
         height,
         {places.data(), {bins, 8}},
         origin});
    Column<std::uint16_t> image(16 * 64);
    range_image(points, -0.1, {image.data(), {16, 64}});
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size == 0) return 0;
    const Bytes rest{data + 1, size - 1};
    if (data[0] % 4 < 2) fuzz_records(data[0] % 2 == 1, rest);
    if (data[0] % 4 == 2) fuzz_pack(rest);
    if (data[0] % 4 == 3) fuzz_frame(rest);
    return 0;
}
