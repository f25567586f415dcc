// Finds the height of every point of a scan above the ground, the points on it and the objects over it; and where it
// drops.
//
// A point is ground if it lies near the surface (surface.cpp), nearer where the ground is smooth, and no plants rise
// from it there. What lies behind an edge is not seen: so the ground is followed outwards, and if what is seen next
// lies too far below where it should go on, there is an edge in between. Ours; records as in ground.py.
#include "surface.hpp"

namespace bumpy {
namespace {

// ---- The points on the ground ----

// A point is ground between these heights over the surface, m: below, and this multiple of the noise of the ground
// above, with limits.
constexpr float below_surface = -0.5F;
constexpr double reach_of_noise = 10.0, least_reach = 0.15, most_reach = 0.25;
// The noise is the spread of the points up to this height over the surface, m, in bins that have this number of them:
// the median over the bins of an octave that has this number of those. Where none has, it is this, m.
constexpr float near_surface = 0.2F;
constexpr double least_points = 5.0, usual_noise = 0.03;
constexpr Index least_bins = 16;
// Plants stand in a bin and those around it if between `near_surface` and this height, m, there are points, as a share
// of those near the surface, and those spread in their bins by more than this multiple of the noise and this, m. They
// stand in the bin itself if it has at least this share of such points, or spreads so.
constexpr float plants_top = 0.95F;
constexpr double plants_share = 0.5, own_share = 0.1, plants_spread = 1.6, plants_least = 0.043;
// Slope of 38 degrees: tan(radians(38)). What is steeper is no ground.
const double steepest = std::tan(38.0 * (std::numbers::pi / 180.0));
// Ground that is higher than this above the origin, m, must have objects on it that are higher than this, m, and more
// of them than hang below it: a frame may have its origin below the robot, or z may point down.
constexpr double highest = 0.5;
constexpr float stands = 0.5F;
// Objects on the ground are drawn up to this multiple of the vehicle's height.
constexpr double objects_height = 2.0;
// Returns in pixels next to each other lie together if their heights are so near to each other, m, at the sensor, and
// more for each metre from it; this number is an object.
constexpr double beside_m = 0.03, beside_per_metre = 0.04;
constexpr float together = 3.0F;

// Obstacles are between belly and height, m; where `overhead` is infinite, ground may hang over the sensor.
struct GroundRule {
    double belly_m, height_m, overhead_m;
};

struct GroundLabels {
    Array<float> height;
    Array<bool> ground;
    Array<std::int32_t> obstacles, overhead;
    Array<bool> airborne;
    Array<float> top, clearance;
    Array<float, 3> objects, lowest;
    Array<bool> kept;
    Array<std::int32_t> held;
    Array<double, 2> surface;
    Array<double> whole;
    Array<float, 2> places;
    Array<double, 2> measures;
};

// The points of a bin near the surface: number, sum and squares of their heights, exact; and the number of those over
// it.
struct NearPoints {
    double count = 0.0, sum = 0.0, squares = 0.0, rising = 0.0;

    void add(float h) {
        if (below_surface < h && h < near_surface) {
            count += 1.0;
            sum += exact(h);
            squares += exact(static_cast<double>(h) * h);
        } else if (h >= near_surface && h < plants_top) {
            rising += 1.0;
        }
    }
    // Sum of the squares of the heights about their mean.
    double scatter() const { return count > 0.0 ? std::max(squares - sum * sum / count, 0.0) : 0.0; }
    double deviation() const { return std::sqrt(scatter() / count); }
};

// The noise of the ground in every ring, m: between the medians of octaves.
Scratch<double> find_noise(const Scratch<NearPoints>& near, const BinRings& rings) {
    Scratch<double> out(rings.count, usual_noise), spreads;
    double before = -1.0, last = usual_noise;
    for (Index begin = 0; begin < rings.count; begin += octave_rings) {
        spreads.clear();
        const Index end = std::min(begin + octave_rings, rings.count) * bin_columns;
        for (Index bin = begin * bin_columns; bin < end; ++bin)
            if (near[bin].count >= least_points) spreads.push_back(near[bin].deviation());
        if (spreads.count() < least_bins) continue;
        const auto middle = spreads.begin() + spreads.count() / 2;
        std::nth_element(spreads.begin(), middle, spreads.end());
        const double here = static_cast<double>(begin) + 0.5 * octave_rings;
        for (Index ring = 0; ring < rings.count; ++ring) {
            const auto at = static_cast<double>(ring);
            if (at < before) continue;
            const double share = before < 0.0 ? 1.0 : std::min((at - before) / (here - before), 1.0);
            out[ring] = last + share * (*middle - last);
        }
        before = here;
        last = *middle;
    }
    return out;
}

// Finds up to which height the points of each bin are ground: none in steep bins, and in those in which plants rise.
void find_reaches(
    const Scratch<NearPoints>& near, const Scratch<Tilt>& planes, const BinRings& rings, Scratch<float>& reach) {
    struct Spread {
        double count, rising, scatter;
    };
    const Scratch<double> noise = find_noise(near, rings);
    Scratch<Spread> sums;
    sums.reserve(near.size());
    for (const NearPoints& bin : near) sums.push_back({bin.count, bin.rising, bin.scatter()});
    for (Index bin = 0; bin < near.count(); ++bin) {
        const Spread& own = sums[bin];
        const Index ring = bin / bin_columns;
        const auto [a, b, c] = planes[bin];
        reach[bin] = static_cast<float>(std::clamp(reach_of_noise * noise[ring], least_reach, most_reach));
        if (a * a + b * b > steepest * steepest) reach[bin] = below_surface;
        if (own.count == 0.0) continue;
        const double plants = std::max(plants_spread * noise[ring], plants_least);
        const auto spread = [](const Spread& of, double least) { return of.scatter > least * least * of.count; };
        if (own.rising < own_share * own.count && !spread(own, plants)) continue;
        Spread all = own;
        around_bin(bin, 1, rings.count, [&](Index other) {
            all.count += sums[other].count;
            all.rising += sums[other].rising;
            all.scatter += sums[other].scatter;
            return true;
        });
        if (all.rising >= plants_share * all.count && spread(all, plants)) reach[bin] = below_surface;
    }
}

// ---- Measures of places ----

// Sums over the points of a bin: ground, and the sum and squares of its heights [m, m^2]; other points below the belly,
// up to the vehicle's height, and above.
enum PlaceSum : std::size_t { ground_points, sum, squares, low, standing, over, place_sums };
using PlaceSums = std::array<double, place_sums>;
// The spread of the ground, m, where there is none, and the number of points that it has there.
constexpr double usual_spread = 0.03, usual_points = 0.5;
constexpr std::size_t place_measures = 7;

// Adds to every bin half of those beside it, outwards and around; the sum of the weights is one.
template <class Values>
void smooth(Scratch<Values>& places) {
    const Index rings = places.count() / bin_columns;
    std::array<Values, bin_columns + 2> row;  // a bin at each end stands for the one at the other
    const Scratch<Values> before = places;
    const Values nothing{};
    for (Index ring = 0; ring < rings; ++ring) {
        for (Index column = 0; column < bin_columns; ++column) {
            const Index bin = ring * bin_columns + column;
            const Values& inner = ring > 0 ? before[bin - bin_columns] : nothing;
            const Values& outer = ring + 1 < rings ? before[bin + bin_columns] : nothing;
            Values& out = row[static_cast<std::size_t>(column + 1)];
            for (std::size_t k = 0; k < nothing.size(); ++k)
                out[k] = 0.5 * before[bin][k] + 0.25 * (inner[k] + outer[k]);
        }
        row.front() = row[bin_columns];
        row.back() = row[1];
        for (std::size_t column = 1; column <= bin_columns; ++column)
            for (std::size_t k = 0; k < nothing.size(); ++k)
                places[ring * bin_columns + static_cast<Index>(column) - 1][k] =
                    0.5 * row[column][k] + 0.25 * (row[column - 1][k] + row[column + 1][k]);
    }
}

// Nearly the logarithm to base 2, see `BinRings`.
double about_log2(double x) { return BinRings::bits(x) / static_cast<double>(1 << 23) - 127.0; }

// Writes the measures of every bin, smoothed over those around it: shares of the points, as roots where they are few,
// the spread of the ground, the number of points, the distance; last, and not one of them, the ground points about it.
void measure_places(Scratch<PlaceSums>& places, Array<float, 2> out) {
    smooth(places);
    Scratch<std::array<double, 1>> ground_about(places.count());
    for (Index bin = 0; bin < places.count(); ++bin) {
        const PlaceSums& of = places[bin];
        ground_about[bin][0] = of[ground_points];
        const double ground = of[ground_points], all = ground + of[low] + of[standing] + of[over] + 1e-3;
        const double scatter = std::max(of[squares] - of[sum] * of[sum] / (ground + 1e-3), 0.0);
        const double variance = (scatter + usual_points * usual_spread * usual_spread) / (ground + usual_points) + 1e-6;
        const std::array<double, place_measures> measures{
            std::sqrt(of[low] / all),
            std::sqrt(of[standing] / all),
            std::sqrt(of[over] / all),
            ground / all,
            0.15 * about_log2(variance),
            0.3 * about_log2(all),
            0.3 * static_cast<double>(bin / bin_columns) / octave_rings};
        for (std::size_t k = 0; k < place_measures; ++k)
            out(bin, static_cast<Index>(k)) = static_cast<float>(measures[k]);
    }
    smooth(ground_about);
    for (Index bin = 0; bin < places.count(); ++bin)
        out(bin, place_measures) = static_cast<float>(ground_about[bin][0]);
}

// Writes the means of the measures over the points of each cell.
void measure_cells(const CellPoints& points, Array<const float, 2> places, Array<double, 2> out) {
    for (Index cell = 0; cell < out.shape[0]; ++cell) {
        std::array<double, place_measures + 1> sums{};  // the ground points too: eight are as fast as seven
        const Index begin = points.starts[cell], end = points.starts[cell + 1];
        for (Index i = begin; i < end; ++i) {
            const float* of = &places(points.bin[i], 0);
            for (std::size_t k = 0; k < sums.size(); ++k) sums[k] += exact(of[k]);
        }
        for (std::size_t k = 0; k < place_measures; ++k)
            out(cell, static_cast<Index>(k)) = sums[k] / static_cast<double>(std::max(end - begin, Index{1}));
    }
}

// ---- Heights ----

// Heights of the points over the surface, and in which bins up to which one they are ground.
struct Labelling {
    Scratch<float> height;     // (points,) by cell, m
    Scratch<float> reach;      // (bins,) m; below all ground where the bin has none
    Scratch<float> lowest;     // (pixels^2,) of the objects in each pixel of a cell, m
    Scratch<Tilt> planes;      // (bins,) that touch the surface
    Scratch<NearPoints> near;  // (bins,)
    Scratch<PlaceSums> places;
};

// Finds the heights of all points, and which bins have ground; returns whether the frame hangs from what looks like
// ground.
bool find_heights(const CellPoints& points, const Surface& surface, const BinRings& rings, Labelling& s) {
    const Index bins = rings.count * bin_columns, placed = points.starts[points.starts.size() - 2];
    renew(s.planes, bins);
    renew(s.near, bins);
    s.height.resize(static_cast<std::size_t>(placed));
    s.reach.resize(static_cast<std::size_t>(bins));
    const Layers& layers = surface.layers;
    for (Index i = 0; i < layers.size(); ++i) {
        const auto [ring, column] = layers.middle(i);
        s.planes[layers.bin[i]] = surface.levels.back().touch(layers.x[i], layers.y[i], ring, column);
    }
    Index over = 0, under = 0;
    for (Index i = 0; i < placed; ++i) {
        const Index bin = points.bin[i];
        const auto h = static_cast<float>(s.planes[bin].above(points.xyz(0, i), points.xyz(1, i), points.xyz(2, i)));
        s.height[i] = h;
        over += h > stands;
        under += h < -stands;
        s.near[bin].add(h);
    }
    find_reaches(s.near, s.planes, rings, s.reach);
    return surface.whole.c > highest && over <= under;
}

// The points above ground in the pixels of a cell, up to `objects_height`: highest, lowest [m], and number.
struct Objects {
    Array<float> top, count, lowest;
};

// Takes returns that lie alone from the objects of a cell: fewer than three in a pixel and those next to it. The beams
// on an object lie side by side, so that its returns do; those from rain, dust or an insect lie alone.
void leave_out_airborne(const Objects& objects, double reach) {
    const auto& [top, count, lowest] = objects;
    const Index pixels = top.size();
    const Index side = std::lround(std::sqrt(static_cast<double>(pixels)));
    for (Index place = 0; place < pixels; ++place) {
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
    for (Index place = 0; place < pixels; ++place)
        if (count[place] < 0.0F) top[place] = count[place] = 0.0F;
}

// Writes which points of a cell are ground, and what the others are; returns whether some are not.
bool label_cell(
    const CellPoints& points, Index cell, const GroundRule& rule, const GroundLabels& out, const Objects& objects,
    Labelling& s) {
    const Array<float, 2> lowest = out.lowest.at(cell);
    const Index begin = points.starts[cell], end = points.starts[cell + 1];
    const auto belly = static_cast<float>(rule.belly_m), height = static_cast<float>(rule.height_m);
    const auto drawn = static_cast<float>(objects_height * rule.height_m);
    std::int32_t held = 0, overhead = 0;
    float clearance = out.clearance[cell];
    for (Index i = begin; i < end; ++i) {
        const float h = s.height[i];
        const bool kept = below_surface < h && h < s.reach[points.bin[i]];
        const Index p = points.order[i], place = points.pixel[i];
        out.height[p] = h;
        out.ground[p] = out.kept[i] = kept;
        float& deepest = lowest(place, kept ? 0 : 1);
        deepest = std::min(deepest, points.xyz(2, i));
        held += kept;
        PlaceSums& sums = s.places[points.bin[i]];
        if (kept) {
            sums[ground_points] += 1.0;
            sums[sum] += exact(h);
            sums[squares] += exact(static_cast<double>(h) * h);
            continue;
        }
        sums[h <= belly ? low : h < height ? standing : over] += 1.0;
        if (h >= height) {
            ++overhead;
            clearance = std::min(clearance, h);
        }
        if (0.0F < h && h < drawn) {
            float& foot = objects.lowest[place];
            foot = objects.count[place] == 0.0F ? h : std::min(foot, h);
            objects.top[place] = std::max(objects.top[place], h);
            objects.count[place] += 1.0F;
        }
    }
    out.held[cell] = held;
    out.overhead[cell] = overhead;
    out.clearance[cell] = clearance;
    return held < end - begin;
}

// Counts the points of obstacles in a cell, and marks those that lie alone.
void count_obstacles(
    const CellPoints& points, Index cell, const GroundRule& rule, const GroundLabels& out, const Objects& objects,
    const Labelling& s) {
    for (Index i = points.starts[cell]; i < points.starts[cell + 1]; ++i) {
        const float h = s.height[i];
        if (out.kept[i] || !(0.0F < h && h < objects_height * rule.height_m)) continue;
        if (objects.count[points.pixel[i]] == 0.0F) {
            out.airborne[points.order[i]] = true;
        } else if (rule.belly_m <= h && h < rule.height_m) {
            ++out.obstacles[cell];
            out.top[cell] = std::max(out.top[cell], h);
        }
    }
}

// Finds the ground, and in each cell the objects on it and over it. `centres`: (cells, 2) x and y, m.
void find_ground(CellPoints points, ZoneGrid grid, Array<const double, 2> centres, GroundRule rule, GroundLabels out) {
    const BinRings rings(grid);
    const Surface surface = find_surface(points, rings);
    thread_local Labelling memory;
    Labelling& s = memory;
    const bool hangs = find_heights(points, surface, rings, s);
    const bool is_found = surface.layers.size() > 0 && !(hangs && rule.overhead_m < infinite);
    s.lowest.resize(static_cast<std::size_t>(out.lowest.shape[1]));
    renew(s.places, rings.count * bin_columns);
    std::copy_n(&surface.whole.a, 3, out.whole.begin());
    for (Index cell = 0; cell < centres.shape[0]; ++cell) {
        const double x = centres(cell, 0), y = centres(cell, 1), square = x * x + y * y;
        const Tilt plane = surface.levels[0].touch(x, y, rings.place(square), full_turn(turn_of(x, y)) * bin_columns);
        std::copy_n(&plane.a, 3, &out.surface(cell, 0));
        if (points.starts[cell] == points.starts[cell + 1]) continue;
        const Array<float, 2> lowest = out.lowest.at(cell);
        std::fill_n(lowest.data, lowest.count(), std::numeric_limits<float>::infinity());
        const Array<float, 2> drawn = out.objects.at(cell);
        std::fill_n(drawn.data, drawn.count(), 0.0F);
        const Objects objects{drawn.at(0), drawn.at(1), {s.lowest.data(), {s.lowest.count()}}};
        if (!is_found) {
            for (Index i = points.starts[cell]; i < points.starts[cell + 1]; ++i) {
                float& low = lowest(points.pixel[i], 1);
                low = std::min(low, points.xyz(2, i));
                out.kept[i] = false;
            }
        } else if (label_cell(points, cell, rule, out, objects, s)) {
            leave_out_airborne(objects, beside_m + beside_per_metre * std::sqrt(square));
            count_obstacles(points, cell, rule, out, objects, s);
        }
    }
    measure_places(s.places, out.places);
    measure_cells(points, out.places, out.measures);
}

// Returns the number of bins of a grid.
Index count_bins(ZoneGrid grid) { return BinRings(grid).count * bin_columns; }

// ---- Classes of places ----

// Writes what a linear function of the measures says of each class into `field` (bins, classes + 1), and the ground
// points about the bins into its last column. `slopes`: (measures + 1, classes), the last ones: of one.
void spread_classes(Array<const float, 2> places, Array<const double, 2> slopes, Array<float, 2> field) {
    const Index measures = slopes.shape[0] - 1, classes = slopes.shape[1];
    for (Index bin = 0; bin < places.shape[0]; ++bin) {
        for (Index c = 0; c < classes; ++c) {
            double says = slopes(measures, c);
            for (Index k = 0; k < measures; ++k) says += slopes(k, c) * places(bin, k);
            field(bin, c) = static_cast<float>(says);
        }
        field(bin, classes) = places(bin, measures);
    }
}

// Finds the classes at the places of points.
void find_classes(Array<const std::uint16_t, 2> place, ClassField field, Array<std::uint8_t> class_id) {
    for (Index i = 0; i < class_id.size(); ++i)
        class_id[i] = place(i, 0) == no_place ? field.unknown : field.at(place(i, 0), place(i, 1));
}

// ---- Drops ----

// Less than `least` is no drop, m, nor what is flatter than `slope` against the slope of the ground before it, nor what
// lies below the `whole` ground (slopes, height) by less than half of `least`: a terrace. The beam to what lies below
// passes the last ground before it above `below`, against that ground, m: if not, the ground goes on, and what is seen
// below is a reflection in it; -infinite where the height of the sensor is not known.
struct DropRule {
    double least, slope, below;
    Array<double> whole;
    Index directions;  // in which the ground is followed
};

// The way outwards in one direction, and the last ground on it.
struct GroundWay {
    double east, north;                    // the direction
    Index last = -1, marked = -1;          // cells: of the last ground, and behind the last drop; -1: none yet
    double r = 0.0, z = 0.0, slope = 0.0;  // of the last ground: distance, height [m] and slope

    // Counts a drop before a return of a cell at a distance and a height, m, if there is one.
    void reach(Index cell, double at, double height, const DropRule& rule, Array<std::int32_t> drops) {
        if (last < 0) return;
        const double way = at - r, level = rule.whole[0] * east + rule.whole[1] * north;
        const double drop = z + slope * way - height, beam = height * r / at - z;
        if (!(drop > std::max(rule.least, rule.slope * way) && beam > rule.below)) return;
        if (!(z + level * way - height > 0.5 * rule.least)) return;
        drops[last] += marked != last;
        drops[cell] += cell != last && cell != marked;
        marked = cell;
    }
};

// Counts the directions in which the ground drops in every cell: for the last cell before a drop, and for that of what
// is seen below. Arrays as in `ground_drops` of ground.py.
void find_drops(
    Array<const float, 3> lowest, Array<const double, 2> slope, Array<const Index> starts, ZoneGrid grid, DropRule rule,
    Array<std::int32_t> drops) {
    const auto pixels = static_cast<double>(grid.pixels);
    for (Index direction = 0; direction < rule.directions; ++direction) {
        const double share = (static_cast<double>(direction) + 0.5) / static_cast<double>(rule.directions);
        const double turn = 2.0 * std::numbers::pi * (share + grid.start);
        GroundWay way{std::cos(turn), std::sin(turn)};
        Index first = 0;
        for (Index zone = 0; zone < grid.sectors.size(); ++zone) {
            const Index rings = grid.rings[zone], sectors = grid.sectors[zone];
            const double around = share * static_cast<double>(sectors);
            const auto sector = static_cast<Index>(around);
            const auto column = static_cast<Index>((around - static_cast<double>(sector)) * pixels);
            const double width = (grid.edges[zone + 1] - grid.edges[zone]) / static_cast<double>(rings * grid.pixels);
            for (Index ring = 0; ring < rings; ++ring) {
                const Index cell = first + ring * sectors + sector;
                if (starts[cell] == starts[cell + 1]) continue;
                for (Index row = 0; row < grid.pixels; ++row) {
                    const Index k = row * grid.pixels + column;
                    const bool is_ground = lowest(cell, k, 0) < infinite;
                    const double z = lowest(cell, k, is_ground ? 0 : 1);
                    if (z == infinite) continue;
                    const double r = grid.edges[zone] + (static_cast<double>(ring * grid.pixels + row) + 0.5) * width;
                    way.reach(cell, r, z, rule, drops);
                    if (!is_ground) continue;
                    way.last = cell;
                    way.r = r;
                    way.z = z;
                    const double own = slope(cell, 0) * way.east + slope(cell, 1) * way.north;
                    way.slope = std::max(own, slope(cell, 2) * way.east + slope(cell, 3) * way.north);
                }
            }
            first += sectors * rings;
        }
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::GroundRule, belly_m, height_m, overhead_m)
BUMPY_RECORD(
    bumpy::GroundLabels, height, ground, obstacles, overhead, airborne, top, clearance, objects, lowest, kept, held,
    surface, whole, places, measures)
BUMPY_RECORD(bumpy::DropRule, least, slope, below, whole, directions)

BUMPY_LOOPS(ground, find_ground, find_drops, count_bins, spread_classes, find_classes)
