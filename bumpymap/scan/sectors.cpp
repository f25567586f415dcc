// Places the points of a scan on the polar grid, measures the ground of its sectors and the objects on it, and finds
// where the ground drops.
//
// Every point is placed once, in blocks that stay in the nearest cache: its cell and pixel on the grid, and its small
// bin around the sensor; then points lie side by side by cell. The surface (surface.cpp) says which points are ground.
// A sector is measured in few passes through its points. What lies behind an edge is not seen: so the ground is
// followed outwards, and if what is seen next lies too far below where it should go on, there is an edge in between.
// Sums are exact, so that the order of the points does not matter. Ours.
#include <cstring>

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

// The pull of the ground around a sector at its plane: the number of points at the sensor that would lie on it, and
// their spread, m^2. On one scan line this decides how the ground leans across it (chosen).
constexpr double plane_pull = 1e-3, slope_pull = 0.1;

// Ground points of a cell, or their means by pixel: place, and height over the ground around the cell, m.
class GroundPoints {
  public:
    Index size() const { return size_; }

    // Forgets all points, and makes room for some, in fours.
    void clear(Index room) {
        size_ = 0;
        for (auto& values : place_)
            if (values.count() < room + 3) values.resize(static_cast<std::size_t>(room + 3));
    }
    void add(double east, double north, double height) {
        place_[0][size_] = east;
        place_[1][size_] = north;
        place_[2][size_++] = height;
    }
    // Calls `act` with four points at a time, and with 1 for each that there is, else 0.
    template <class Act>
    void each_four(Act act) const {
        const std::array from{place_[0].data(), place_[1].data(), place_[2].data()};
        std::array<Four, 3> four;
        for (Index i = 0; i < size_; i += 4) {
            const auto left = static_cast<double>(size_ - i);
            const Four is_there = Four{0.0, 1.0, 2.0, 3.0} < left ? Four{} + 1.0 : Four{};
            for (std::size_t axis = 0; axis < 3; ++axis) std::memcpy(&four[axis], from[axis] + i, sizeof(Four));
            act(is_there, four[0], four[1], four[2]);
        }
    }
    // The plane of those within `reach` of a plane, m.
    Tilt fit(Tilt near, double reach) const {
        FitSums<Four> four;
        each_four([&](const Four& is_there, const Four& x, const Four& y, const Four& h) {
            const Four over = h - (near.a * x + near.b * y + near.c);
            four.add((over < reach) & (over > -reach) ? is_there : Four{}, x, y, h);
        });
        FitSums<double> sums;
        for (std::size_t k = 0; k < 4; ++k) sums.add(four, k);
        return fit_plane(sums, plane_pull, slope_pull);
    }

  private:
    Index size_ = 0;
    std::array<Scratch<double>, 3> place_;
};

// A heightmap in work, with a margin of a pixel, where all neighbours exist.
struct Padded {
    Scratch<float> height, known, inside;  // unknown heights are 0; 1 or 0; 0 in the margin, 1 elsewhere
};

// A frame on its way through the loop: memory that is kept from scan to scan.
struct Frame {
    Scratch<std::int32_t> cell;    // (scan's points,) -1 outside of the grid
    Scratch<PointPlace> place;     // the same
    Scratch<Index> starts;         // (cells + 2,) cell c has the points from `starts[c]` to `starts[c + 1]`
    PlacedPoints points;           // by cell
    Scratch<float> height, reach;  // see `find_surface`
    Scratch<Tilt> around, own;     // (cells,) the ground around their middles, and that of their points
    Scratch<std::array<float, 2>>
        lowest;                    // (cells * pixels^2,) z of the lowest ground point and of the lowest other, m
    GroundPoints ground;           // of the cell that is measured
    Scratch<Four> sums;            // (pixels^2,) number of its ground points, and sums of x, y and height, m
    GroundPoints means;            // of pixels with ground points
    Scratch<std::int32_t> others;  // of its points that are not ground, and not high above it
    Scratch<float> feet;           // (pixels^2,) height of the lowest object in each, m
    Padded image;                  // of the cell in work
};

// ---- The points by cell ----

// Points whose distance and direction are found at once.
constexpr Index block_points = 512;

// A zone of the grid; cells are numbered by zone, ring and sector.
struct Zone {
    double begin, rings_per_m, sectors_per_turn;
    std::int32_t first, rings, sectors;

    Index end() const { return first + rings * sectors; }
    // The cell at a distance, m, and a turn from sector 0, and the pixel in it.
    std::array<std::int32_t, 2> at(double away, double turn, std::int32_t pixels) const {
        const double outwards = (away - begin) * rings_per_m, around = turn * sectors_per_turn;
        const std::int32_t ring = std::min(static_cast<std::int32_t>(outwards), rings - 1);
        const std::int32_t sector = std::min(static_cast<std::int32_t>(around), sectors - 1);
        const auto row = static_cast<std::int32_t>((outwards - ring) * pixels);
        const auto column = static_cast<std::int32_t>((around - sector) * pixels);
        return {first + ring * sectors + sector, std::min(row, pixels - 1) * pixels + std::min(column, pixels - 1)};
    }
};

Scratch<Zone> zones_of(const ZoneGrid& grid) {
    Scratch<Zone> zones;
    for (Index k = 0; k < grid.sectors.size(); ++k) {
        const auto rings = static_cast<double>(grid.rings[k]), sectors = static_cast<double>(grid.sectors[k]);
        const Index first = k > 0 ? zones.back().end() : 0;
        zones.push_back(
            {grid.edges[k], rings / (grid.edges[k + 1] - grid.edges[k]), sectors, static_cast<std::int32_t>(first),
             static_cast<std::int32_t>(rings), static_cast<std::int32_t>(sectors)});
    }
    return zones;
}

// Places of some points: distance, m, and turn from sector 0; ring and column of bins, in parts of one; zone, one more
// than the last beyond it, and -1 before the first.
struct PointBlock {
    std::array<double, block_points> x, y, away, turn;
    std::array<std::int32_t, block_points> ring, column, zone;

    // Finds them without a branch: several at once.
    void find(const float* points, std::size_t count, const ZoneGrid& grid, const BinRings& rings) {
        for (std::size_t i = 0; i < count; ++i) {
            x[i] = points[3 * i];
            y[i] = points[3 * i + 1];
        }
        for (std::size_t i = 0; i < count; ++i) {
            const double square = x[i] * x[i] + y[i] * y[i], whole = full_turn(turn_of(x[i], y[i]));
            away[i] = std::sqrt(square);
            turn[i] = full_turn(whole - grid.start);
            ring[i] = rings.parts(square);
            column[i] = static_cast<std::int32_t>(whole * static_cast<double>(bin_columns * bin_parts));
            zone[i] = -1;
        }
        for (const double edge : grid.edges)
            for (std::size_t i = 0; i < count; ++i) zone[i] += away[i] >= edge ? 1 : 0;
    }
};

// Finds the cell of every point and its place in bins, and lists the points by cell.
void place_points(
    Array<const float, 2> points, const ZoneGrid& grid, const Scratch<Zone>& zones, Index pixels, const BinRings& rings,
    Array<std::uint16_t, 2> place, Frame& s) {
    const Index size = points.shape[0];
    PointBlock block;
    s.cell.resize(static_cast<std::size_t>(size));
    s.place.resize(static_cast<std::size_t>(size));
    renew(s.starts, zones.back().end() + 2);
    for (Index p = 0; p < size; ++p) {
        const auto i = static_cast<std::size_t>(p % block_points);
        if (i == 0) {
            const Index count = std::min(block_points, size - p);
            block.find(&points(p, 0), static_cast<std::size_t>(count), grid, rings);
        }
        const Index zone = block.zone[i];
        const bool is_inside = 0 <= zone && zone < zones.count();
        s.cell[p] = -1;
        place(p, 0) = is_inside ? static_cast<std::uint16_t>(block.ring[i]) : no_place;
        place(p, 1) = static_cast<std::uint16_t>(block.column[i]);
        if (!is_inside) continue;
        const auto [cell, pixel] = zones[zone].at(block.away[i], block.turn[i], static_cast<std::int32_t>(pixels));
        const Index bin = place(p, 0) / bin_parts * bin_columns + place(p, 1) / bin_parts;
        s.cell[p] = cell;
        s.place[p] = {static_cast<std::uint16_t>(pixel), static_cast<std::uint16_t>(bin)};
        ++s.starts[cell + 2];
    }
    for (Index c = 2; c < s.starts.count(); ++c) s.starts[c] += s.starts[c - 1];
    s.points.point.resize(static_cast<std::size_t>(s.starts.back()));
    s.points.place.resize(s.points.point.size());
    renew(s.points.lowest, rings.count * bin_columns, std::numeric_limits<float>::infinity());
    for (Index p = 0; p < size; ++p) {
        if (s.cell[p] < 0) continue;
        const Index to = s.starts[s.cell[p] + 1]++;
        s.points.point[to] = {points(p, 0), points(p, 1), points(p, 2), static_cast<std::int32_t>(p)};
        s.points.place[to] = s.place[p];
        float& lowest = s.points.lowest[s.place[p].bin];
        lowest = std::min(lowest, points(p, 2));
    }
}

// ---- The ground of sectors ----

// Fewest ground points of a sector that has ground (chosen).
constexpr Index least_ground = 10;
// A sector's plane is that of the means by pixel of its ground, then twice that of those nearer to it than this, m.
constexpr double near_plane = 0.1;

// Most pixels along a side of a heightmap with its margin: `PolarSettings` allows 64.
constexpr std::size_t most_wide = 66;

// Gives unknown pixels the mean of their known neighbours, without a branch: several at once; returns the number of
// those that have any. Values as in `Padded`.
std::int32_t fill_rim(Index wide, float* height, float* known, const float* inside) {
    const auto all = static_cast<std::size_t>(wide * wide);
    std::array<float, most_wide * most_wide> three_heights, three_known;  // sums of three pixels outwards
    for (auto p = static_cast<std::size_t>(wide); p < all - wide; ++p) {
        three_heights[p] = height[p - wide] + height[p] + height[p + wide];
        three_known[p] = known[p - wide] + known[p] + known[p + wide];
    }
    std::int32_t filled = 0;
    for (auto p = static_cast<std::size_t>(wide + 1); p < all - wide - 1; ++p) {
        const float total = three_heights[p - 1] + three_heights[p] + three_heights[p + 1];
        const float count = (three_known[p - 1] + three_known[p] + three_known[p + 1]) * inside[p];
        const bool fills = (known[p] == 0.0F) & (count > 0.0F);
        height[p] = fills ? total / count : height[p];
        known[p] = fills ? 1.0F : known[p];
        filled += fills ? 1 : 0;
    }
    return filled;
}

// Writes the mean height over a plane of every pixel, and into empty ones, from the rim inwards, the mean of their
// known neighbours.
void fill_heights(Tilt plane, Array<float, 2> heights, Frame& s) {
    const Index size = heights.shape[0], wide = size + 2;
    auto& [height, known, inside] = s.image;
    for (auto* values : {&height, &known, &inside}) renew(*values, wide * wide);
    for (Index k = 0; k < size * size; ++k) {
        const Index p = (k / size + 1) * wide + k % size + 1;
        inside[p] = 1.0F;
        if (s.sums[k][0] == 0.0) continue;
        const Four mean = s.sums[k] / s.sums[k][0];
        height[p] = static_cast<float>(plane.above(mean[1], mean[2], mean[3]));
        known[p] = 1.0F;
    }
    for (Index missing = size * size - s.means.size(); missing > 0;)
        missing -= fill_rim(wide, height.data(), known.data(), inside.data());
    for (Index row = 0; row < size; ++row) std::copy_n(&height[(row + 1) * wide + 1], size, heights.at(row).begin());
}

// Measures the ground of a sector: normal, spread, heightmap; returns its plane. `around`: the ground around it;
// `whole`: that of the scan.
Tilt measure_ground(Tilt around, Tilt whole, const ScanRule& rule, Index row, const SectorRows& out, Frame& s) {
    const Index size = s.ground.size(), pixels = rule.pixels * rule.pixels;
    s.means.clear(pixels);
    for (Index k = 0; k < pixels; ++k) {
        if (s.sums[k][0] == 0.0) continue;
        const Four mean = s.sums[k] / s.sums[k][0];
        s.means.add(mean[1], mean[2], mean[3]);
    }
    const Tilt all = s.ground.fit({}, infinite),
               plane = s.means.fit(s.means.fit(s.means.fit({}, infinite), near_plane), near_plane);
    const double a = around.a + all.a, b = around.b + all.b, upward = 1.0 / std::sqrt(a * a + b * b + 1.0);
    out.normal(row, 0) = static_cast<float>(-a * upward);
    out.normal(row, 1) = static_cast<float>(-b * upward);
    out.normal(row, 2) = static_cast<float>(upward);
    const double over = all.c + around.c - std::max(whole.c, 0.0);
    out.traversable[row] = upward >= rule.least_normal_z && over <= rule.overhead_m;
    Four total{}, square{}, residual{};
    s.ground.each_four([&](const Four& is_there, const Four& x, const Four& y, const Four& h) {
        const Four z = (h + around.a * x + around.b * y) * is_there, away = h - (plane.a * x + plane.b * y + plane.c);
        add_exact<Four>(total, z);
        add_exact<Four>(square, z * z);
        add_exact<Four>(residual, (away < 0.0 ? -away : away) * is_there);
    });
    const auto mean = [size](const Four& sums) { return sum_of(sums) / static_cast<double>(size); };
    const double east = around.a + plane.a, north = around.b + plane.b;
    out.variance[row] = static_cast<float>(std::max(mean(square) - mean(total) * mean(total), 0.0));
    out.residual[row] = static_cast<float>(mean(residual) / std::sqrt(east * east + north * north + 1.0));
    fill_heights(plane, out.heights.at(row), s);
    out.coverage[row] = static_cast<float>(s.means.size()) / static_cast<float>(pixels);
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
    const Index pixels = rule.pixels * rule.pixels, begin = s.starts[cell], end = s.starts[cell + 1];
    const Array<float, 3> drawn = out.objects.at(row);
    std::fill_n(drawn.data, drawn.count(), 0.0F);
    s.feet.resize(static_cast<std::size_t>(pixels));
    const Objects objects{{drawn.data, {pixels}}, {drawn.data + pixels, {pixels}}, {s.feet.data(), {pixels}}};
    const auto belly = static_cast<float>(rule.belly_m), height = static_cast<float>(rule.height_m);
    const float top = objects_height * height;
    const Tilt around = s.around[cell];
    std::array<Four, 2> measures{};
    std::int32_t overhead = 0, obstacles = 0;
    float clearance = std::numeric_limits<float>::infinity(), highest_obstacle = 0.0F;
    s.ground.clear(end - begin);
    renew(s.sums, pixels);
    s.others.clear();
    const bool is_row = end - begin > rule.least_points;
    for (Index i = begin; i < end; ++i) {
        const auto [x, y, z, number] = s.points.point[i];
        const auto [pixel, bin] = s.points.place[i];
        const float h = s.height[i];
        const bool is_ground = below_surface < h && h < s.reach[bin];
        of.point_height[number] = h;
        of.point_ground[number] = is_ground;
        of.point_sector[number] = is_row ? static_cast<std::int32_t>(row) : -1;
        float& deepest = s.lowest[cell * pixels + pixel][is_ground ? 0 : 1];
        deepest = std::min(deepest, z);
        const float* place = &of.places(bin, 0);
        add_exact(measures[0], Four{place[0], place[1], place[2], place[3]});
        add_exact(measures[1], Four{place[4], place[5], place[6], place[7]});
        if (is_ground) {
            const double over = around.above(x, y, z);
            s.ground.add(x, y, over);
            add_exact(s.sums[pixel], Four{1.0, x, y, over});
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
            s.others.push_back(static_cast<std::int32_t>(i));
        }
    }
    if (!s.others.empty()) leave_out_airborne(objects, beside_m + beside_per_metre * away, rule.pixels);
    for (const Index i : s.others) {
        const float h = s.height[i];
        if (objects.count[s.points.place[i].pixel] == 0.0F) {
            of.point_airborne[s.points.point[i].number] = true;
        } else if (belly <= h && h < height) {
            ++obstacles;
            highest_obstacle = std::max(highest_obstacle, h);
        }
    }
    const bool has_ground = s.ground.size() >= least_ground;
    const float unknown = std::numeric_limits<float>::quiet_NaN();
    out.count[row] = static_cast<std::int32_t>(end - begin);
    out.obstacle_count[row] = obstacles;
    out.overhead_count[row] = overhead;
    out.obstacle_height[row] = has_ground && obstacles >= least_obstacle ? highest_obstacle : unknown;
    out.clearance[row] = overhead > 0 ? clearance : unknown;
    for (Index k = 0; k < out.measures.shape[1]; ++k)
        out.measures(row, k) = measures[static_cast<std::size_t>(k / 4)][k % 4] / static_cast<double>(end - begin);
    if (has_ground) {
        s.own[cell] = measure_ground(around, whole, rule, row, out, s);
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
// Points come without height, ground and sector, and as not airborne.
Index find_sectors(Array<const float, 2> points, ZoneGrid grid, ScanRule rule, SectorRows out, PointRows of) {
    Frame& s = kept_memory<Frame>();
    const BinRings rings(grid);
    const Scratch<Zone> zones = zones_of(grid);
    const Index cells = zones.back().end(), pixels = rule.pixels * rule.pixels;
    place_points(points, grid, zones, rule.pixels, rings, of.point_place, s);
    const auto [whole, wide, hangs] = find_surface(s.points, rings, s.height, s.reach);
    if (hangs && rule.overhead_m < infinite) {
        std::fill(s.reach.begin(), s.reach.end(), below_surface);
        std::fill(s.height.begin(), s.height.end(), std::numeric_limits<float>::quiet_NaN());
    }
    measure_places(
        s.points, s.height, s.reach, static_cast<float>(rule.belly_m), static_cast<float>(rule.height_m), of.places);
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
        measure_cell(cell, away, whole, rule, rows, out, of, s);
        if (s.starts[cell + 1] - s.starts[cell] <= rule.least_points) return;
        out.zone[rows] = static_cast<std::int16_t>(zone);
        out.ring[rows] = static_cast<std::int16_t>(ring);
        out.sector[rows] = static_cast<std::int16_t>(sector);
        row_of[cell] = static_cast<std::int32_t>(rows++);
    };
    for (Index zone = 0; zone < grid.sectors.size(); ++zone)
        for (Index ring = 0; ring < grid.rings[zone]; ++ring)
            for (Index sector = 0; sector < grid.sectors[zone]; ++sector, ++cell) measure(zone, ring, sector);
    const Scratch<std::int32_t> drops = find_drops(grid, rule.pixels, rule.belly_m, whole, s);
    for (Index c = 0; c < cells; ++c) {
        const Index row = row_of[c];
        if (row < 0) continue;
        const double seen = static_cast<double>(drop_directions) / static_cast<double>(grid.sectors[out.zone[row]]);
        out.drop[row] = out.ground_count[row] > 0 && drops[c] >= drop_share * seen;
    }
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
