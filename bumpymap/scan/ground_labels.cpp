// Finds which points of a scan lie on the ground, which are objects on it, and where it drops.
//
// Points near the plane of their cell are ground; so are parts of a cell beside the plane, thin and continuing the
// ground next to them. What lies behind an edge is not seen, and a plane that is fitted to both sides passes over it:
// so the ground is followed outwards, and if what is seen next lies too far below where it should go on, there is an
// edge in between. Ours; see ground.py.
#include "ground.hpp"

namespace bumpy {
namespace {

// ---- The points on the ground ----

// Objects on the ground are drawn up to this multiple of the vehicle's height.
constexpr double objects_height = 2.0;
// Points further below a plane than this are reflections, m.
constexpr double below_plane = 0.5;
// A part beside the plane is ground too if it has this number of points, spreads less than this, at a height between
// these, and passes a neighbouring part of the ground at less than this; its ground points are so near to their mean,
// m.
constexpr double part_points = 3.0, part_spread = 0.12, part_lowest = -0.6, part_highest = 1.2, part_step = 0.2;
constexpr double part_reach = 0.2;
// Returns in pixels next to each other lie together if their heights are so near to each other, m, at the sensor, and
// more for each metre from it; this number is an object.
constexpr double beside_m = 0.03, beside_per_metre = 0.04;
constexpr float together = 3.0F;
// Rounds in which the ground spreads to parts beside it.
constexpr int most_rounds = 6;
// Points further from a plane than this do not belong to the layer of the ground, m.
constexpr double layer = 1.5;
// Plants stand in a part if so high above its ground at most, m, there are points, as a share of those on it, and those
// on it spread by more than this multiple of the scan's noise and more than this, m.
constexpr double plants_above = 0.8, plants_share = 0.2, plants_spread = 1.8, plants_least = 0.045;

struct GroundRule {
    Array<const double> reach, noise;
    Index least_points;
    double belly, height;
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
};

enum class State : std::uint8_t { none, may_continue, continues_ground, is_grown, plants };

// A part of a cell, see `parts`.
struct Part {
    double count = 0.0, sum = 0.0, squares = 0.0, ground = 0.0;  // of the heights of its points
    double level = std::numeric_limits<double>::quiet_NaN();     // of its ground above the plane, m; NaN: it has none
    State state = State::none;

    double mean() const { return sum / count; }
};

// Points and cells while they are labelled.
struct Labelling {
    Scratch<float> height;        // (points,) above the plane, by cell, m
    Scratch<Part> parts;          // (cells * parts_of_cell,)
    Scratch<std::uint8_t> mixed;  // (cells,) whether some points are not on the plane
    Scratch<float> lowest;        // (pixels^2,) of the objects in each pixel of a cell, m

    Part& part(Index cell, Index inside) { return parts[cell * parts_of_cell + inside]; }
};

// Finds the height of every point of a cell above its plane, and which lie on it; if not all do, sums by part.
void measure_heights(
    const CellPoints& points, Index cell, const GroundPlanes& planes, double zone_reach, Index least_points,
    Array<bool> kept, Labelling& s) {
    const Slope plane = planes.at(cell);
    const Index first = points.starts[cell], last = points.starts[cell + 1];
    const bool is_own = planes.kind[cell] == found;
    const double below = is_own ? -below_plane : -zone_reach;
    const double reach = !is_own && last - first > least_points ? -infinite : zone_reach;
    Index held = 0;
    for (Index i = first; i < last; ++i) {
        const double h = points.xyz(2, i) - plane.height(points.xyz(0, i), points.xyz(1, i));
        s.height[i] = static_cast<float>(h);
        kept[i] = below < h && h < reach;
        held += kept[i];
    }
    s.mixed[cell] = held < last - first;
    for (Index i = first; i < last; ++i) {
        Part& part = s.part(cell, points.part[i]);
        const float h = s.height[i];
        if (held == last - first) {
            part.level = 0.0;
        } else if (std::abs(h) < layer) {
            part.count += 1.0;
            part.sum += h;
            part.squares += h * h;
            part.ground += kept[i];
        }
    }
}

// The part next to another one in the same zone; none beyond its border.
const Part* part_beside(
    Index cell, Index inside, Index outwards, Index around, const CellGeometry& geometry, Labelling& s) {
    const Index zone = geometry.zone[cell];
    const Index rows = geometry.rings[zone] * parts, columns = geometry.sectors[zone] * parts;
    const Index row = geometry.ring[cell] * parts + inside / parts + outwards;
    if (row < 0 || row >= rows) return nullptr;
    const Index column = (geometry.sector[cell] * parts + inside % parts + around + columns) % columns;
    const Index home = geometry.first[zone] + (row / parts) * geometry.sectors[zone] + column / parts;
    return &s.part(home, (row % parts) * parts + column % parts);
}

bool continues_beside(Index cell, Index inside, const CellGeometry& geometry, Labelling& s) {
    const double mean = s.part(cell, inside).mean();
    for (Index around = 0; around < 9; ++around) {
        const Part* other = part_beside(cell, inside, around / 3 - 1, around % 3 - 1, geometry, s);
        if (other != nullptr && std::abs(other->level - mean) < part_step) return true;
    }
    return false;
}

// Gives a level to parts that are ground, and to thin ones that continue them: kerbs, banks, terraces.
void grow(const CellGeometry& geometry, Labelling& s) {
    const auto of_mixed = [&](auto&& act) {
        for (Index cell = 0; cell < geometry.cells(); ++cell)
            for (Index inside = 0; inside < parts_of_cell && s.mixed[cell] != 0; ++inside) act(cell, inside);
    };
    of_mixed([&s](Index cell, Index inside) {
        Part& part = s.part(cell, inside);
        if (part.ground > 0.0 && part.ground >= 0.5 * part.count) {
            part.level = 0.0;
        } else if (part.count >= part_points) {
            const double mean = part.mean();
            const bool thin = part.squares / part.count - mean * mean < part_spread * part_spread;
            if (thin && part_lowest < mean && mean < part_highest) part.state = State::may_continue;
        }
    });
    bool grown = true;
    for (int round = 0; round < most_rounds && grown; ++round) {
        grown = false;
        of_mixed([&](Index cell, Index inside) {
            State& state = s.part(cell, inside).state;
            if (state != State::may_continue || !continues_beside(cell, inside, geometry, s)) return;
            state = State::continues_ground;
            grown = true;
        });
        of_mixed([&s](Index cell, Index inside) {
            Part& part = s.part(cell, inside);
            if (part.state != State::continues_ground) return;
            part.level = part.mean();
            part.state = State::is_grown;
        });
    }
}

// Adds the points of grown parts to the ground of a cell, and finds the parts in which plants rise from it.
void mark_plants(const CellPoints& points, Index cell, double reach, double least, Array<bool> kept, Labelling& s) {
    for (Index inside = 0; inside < parts_of_cell; ++inside) {
        Part& part = s.part(cell, inside);
        part.count = part.squares = part.sum = 0.0;
    }
    for (Index i = points.starts[cell]; i < points.starts[cell + 1]; ++i) {
        Part& part = s.part(cell, points.part[i]);
        const float h = s.height[i];
        if (part.state == State::is_grown) kept[i] = std::abs(h - part.level) < part_reach;
        if (kept[i]) {
            part.count += 1.0;
            part.squares += h * h;
        } else if (reach < h && h < reach + plants_above) {
            part.sum += 1.0;
        }
    }
    for (Index inside = 0; inside < parts_of_cell; ++inside) {
        Part& part = s.part(cell, inside);
        const bool rises = part.sum >= plants_share * part.count;
        part.state = rises && part.squares > least * least * part.count ? State::plants : State::none;
    }
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

// Writes which points of a cell with a plane are ground, and what the others are.
void label_cell(
    const CellPoints& points, Index cell, const GroundRule& rule, const GroundLabels& out, const Objects& objects,
    Labelling& s) {
    const bool mixed = s.mixed[cell] != 0;
    const Array<float, 2> lowest = out.lowest.at(cell);
    for (Index i = points.starts[cell]; i < points.starts[cell + 1]; ++i) {
        const float h = s.height[i], z = points.xyz(2, i);
        const Index p = points.order[i], place = points.pixel[i];
        out.height[p] = h;
        if (!mixed || (out.kept[i] && s.part(cell, points.part[i]).state != State::plants)) {
            out.ground[p] = true;
            ++out.held[cell];
            lowest(place, 0) = std::min(lowest(place, 0), z);
            continue;
        }
        out.kept[i] = false;
        lowest(place, 1) = std::min(lowest(place, 1), z);
        if (h >= rule.height) {
            ++out.overhead[cell];
            out.clearance[cell] = std::min(out.clearance[cell], h);
        }
        if (0.0F < h && h < objects_height * rule.height) {
            float& low = objects.lowest[place];
            low = objects.count[place] == 0.0F ? h : std::min(low, h);
            objects.top[place] = std::max(objects.top[place], h);
            objects.count[place] += 1.0F;
        }
    }
}

// Counts the points of obstacles in a cell, and marks those that lie alone.
void count_obstacles(
    const CellPoints& points, Index cell, const GroundRule& rule, const GroundLabels& out, const Objects& objects,
    const Labelling& s) {
    for (Index i = points.starts[cell]; i < points.starts[cell + 1]; ++i) {
        const float h = s.height[i];
        if (out.kept[i] || !(0.0F < h && h < objects_height * rule.height)) continue;
        if (objects.count[points.pixel[i]] == 0.0F) {
            out.airborne[points.order[i]] = true;
        } else if (rule.belly <= h && h < rule.height) {
            ++out.obstacles[cell];
            out.top[cell] = std::max(out.top[cell], h);
        }
    }
}

// Finds which points are ground, and in each cell the objects on the ground and over it.
void label_points(CellPoints points, CellGeometry geometry, GroundPlanes planes, GroundRule rule, GroundLabels out) {
    const Index cells = geometry.cells(), pixels = out.lowest.shape[1];
    Labelling s{
        Scratch<float>(out.kept.size()), Scratch<Part>(cells * parts_of_cell), Scratch<std::uint8_t>(cells),
        Scratch<float>(pixels)};
    for (Index cell = 0; cell < geometry.cells(); ++cell)
        if (planes.kind[cell] != 0)
            measure_heights(points, cell, planes, rule.reach[geometry.zone[cell]], rule.least_points, out.kept, s);
    grow(geometry, s);
    for (Index cell = 0; cell < geometry.cells(); ++cell) {
        const Index begin = points.starts[cell], end = points.starts[cell + 1];
        if (begin == end) continue;
        const Array<float, 2> lowest = out.lowest.at(cell);
        std::fill_n(lowest.data, lowest.count(), std::numeric_limits<float>::infinity());
        const Array<float, 2> drawn = out.objects.at(cell);
        std::fill_n(drawn.data, drawn.count(), 0.0F);
        const Objects objects{drawn.at(0), drawn.at(1), {s.lowest.data(), {pixels}}};
        if (planes.kind[cell] == 0) {
            for (Index i = begin; i < end; ++i) {
                float& lowest_other = lowest(points.pixel[i], 1);
                lowest_other = std::min(lowest_other, points.xyz(2, i));
                out.kept[i] = false;
            }
            continue;
        }
        const Index zone = geometry.zone[cell];
        if (s.mixed[cell] != 0) {
            const double least = std::max(plants_spread * rule.noise[zone], plants_least);
            mark_plants(points, cell, rule.reach[zone], least, out.kept, s);
        }
        label_cell(points, cell, rule, out, objects, s);
        if (s.mixed[cell] != 0) {
            const double x = geometry.x[cell], y = geometry.y[cell];
            leave_out_airborne(objects, beside_m + beside_per_metre * std::sqrt(x * x + y * y));
            count_obstacles(points, cell, rule, out, objects, s);
        }
    }
}

// ---- Drops ----

struct DropRule {
    double least, slope, below, slope_x, slope_y;
    Index directions;
};

// The way outwards in one direction, and the last ground on it.
struct GroundWay {
    double east, north;                    // the direction
    Index last = -1, marked = -1;          // cells: of the last ground, and behind the last drop; -1: none yet
    double r = 0.0, z = 0.0, slope = 0.0;  // of the last ground: distance, height [m] and slope

    // Counts a drop before a return of a cell at a distance and a height, m, if there is one.
    void reach(Index cell, double at, double height, const DropRule& rule, Array<std::int32_t> drops) {
        if (last < 0) return;
        const double way = at - r, level = rule.slope_x * east + rule.slope_y * north;
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
                    way.slope = slope(cell, 0) * way.east + slope(cell, 1) * way.north;
                }
            }
            first += sectors * rings;
        }
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::GroundRule, reach, noise, least_points, belly, height)
BUMPY_RECORD(
    bumpy::GroundLabels, height, ground, obstacles, overhead, airborne, top, clearance, objects, lowest, kept, held)
BUMPY_RECORD(bumpy::DropRule, least, slope, below, slope_x, slope_y, directions)

void bind_ground_labels(nb::module_& module) {
    using namespace bumpy;
    BUMPY_LOOP(module, label_points);
    BUMPY_LOOP(module, find_drops);
}
