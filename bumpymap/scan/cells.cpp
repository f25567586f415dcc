// Square cells around a sensor: the height of their ground, objects on it and over it, and whether they are free.
//
// Points are sorted into cells, and the lowest of them into rays from the sensor by rings of cells. Along each ray the
// ground is followed outwards: it goes on between two returns if the beam to the farther one passes the nearer one so
// low that no obstacle can hide there, and it drops where what is seen next lies too far below. A cell is judged by its
// own points and by the rays through it. Ours; records as in cells.py.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "polar.hpp"

namespace bumpy {
namespace {

// Rays from the sensor through each side of a grid of square cells, counter-clockwise: at 30 m they are 0.33 m apart.
constexpr Index side_rays = 180;
constexpr Index all_rays = 4 * side_rays;
// Points whose cells are found at once: they stay in the nearest cache.
constexpr Index block_points = 512;
constexpr float nothing = std::numeric_limits<float>::infinity();

// The square cells around a sensor, as a scan shows them, from the lowest y upwards, and in each row from the lowest x;
// unknown heights are NaN.
struct SquareCells {
    Array<std::uint8_t> kind;      // class of the ground; one more than the last where a vehicle cannot go, and one
                                   // more where unknown
    Array<std::uint8_t> class_id;  // of the ground, beneath objects too
    Array<std::int32_t> sector;    // row of the sector whose ground is known in the cell; -1 without any
    Array<float> elevation, step;  // mean z of the ground points; largest difference from a cell beside it, m
    Array<float> top, clearance;   // of an obstacle, and lowest point that a vehicle passes under, over the ground, m
    Array<float> tip;              // z of the top, m
};

// A classified scan; arrays by sector have one row more, for points in none.
struct ClassedPoints {
    Array<const float, 2> points;              // (points, 3) m
    Array<const bool> ground, airborne;        // (points,) whether it is ground; whether it is left out
    Array<const float> height;                 // (points,) over the ground of its sector, m; NaN where none is known
    Array<const std::int32_t> sector;          // (points,) row of its sector; -1 if it is in none
    Array<const std::uint8_t> kind, class_id;  // of the ground of sectors
    Array<const bool> drops;                   // whether the ground of sectors drops
    Array<const double, 2> slope;              // (sectors + 1, 2) along x and y; the last one: of the whole ground

    // The row of a sector in arrays by sector: the last one for -1.
    Index row(Index sector_or_none) const { return sector_or_none < 0 ? kind.size() - 1 : sector_or_none; }

    // How much the ground of a sector rises along a way, m.
    double rise(Index sector_or_none, double x, double y) const {
        const Index of = row(sector_or_none);
        return slope(of, 0) * x + slope(of, 1) * y;
    }
};

struct CellRule {
    double resolution;     // side of a cell, m
    Index half;            // cells from the sensor to each side of the grid
    double belly, height;  // lower objects and steps pass under a vehicle; objects from here on pass over it, m
    Index beneath;         // cells behind an object in which ground that is seen beneath it is not known to be free
    Array<const double, 2> to_sensor;  // (2, 3) from columns and rows of cells to x and y in the frame of the sensor, m

    Index side() const { return 2 * half; }
};

// The lowest points by ray and ring: z of the lowest ground, of the lowest and -z of the highest other point, m;
// infinite without any; and, read with them, the row of the sector of the lowest ground.
struct Returns {
    float ground = nothing, lowest = nothing, highest = nothing, sector = nothing;
};

// The view along a ray in a ring: the row of the sector whose ground is seen, or goes on, or: nothing is known; the
// ground is seen beneath an object that hides what is on it; the ground drops.
constexpr std::int32_t unseen = -1, beneath_object = -2, falls = -3;

// Numbers by cell, by ray and by ring while the cells are laid: memory that is kept.
struct Laying {
    Scratch<std::int32_t> cell;        // (points,) the cell of each; -1 outside
    Scratch<double> count, total;      // (cells,) number of ground points, and the sum of their z, m
    Scratch<std::uint8_t> stands;      // (cells,) whether an obstacle stands there
    Scratch<std::uint8_t> has_others;  // (cells,) whether some points are not ground
    Scratch<double> level;             // (cells,) elevation of the ground, or the mean around it, m; or NaN
    Scratch<Returns> returns;          // by `slot_of`
    Scratch<std::int32_t> seen;        // (all_rays, half) as above

    void renew_all(Index points, Index half) {
        const Index cells = 4 * half * half;
        cell.resize(static_cast<std::size_t>(points));
        level.resize(static_cast<std::size_t>(cells));
        for (auto* numbers : {&count, &total}) renew(*numbers, cells);
        for (auto* flags : {&stands, &has_others}) renew(*flags, cells);
        renew(returns, all_rays * half);
        renew(seen, all_rays * half, unseen);
    }
};

// Place of a ray and a ring in `Laying::returns`: four rays side by side share a line of the cache.
Index slot_of(Index ray, Index ring, Index half) { return ((ray / 4) * half + ring) * 4 + ray % 4; }

// ---- The points ----

struct Blocks {
    std::array<double, block_points> x, y;  // in cells
    std::array<std::int32_t, block_points> cell, slot;
};

// Finds the cells and the slots of some points, without a branch: several at once.
void find_cells(const ClassedPoints& scan, Index begin, Index count, const CellRule& rule, Blocks& out) {
    const double half = static_cast<double>(rule.half), scale = 1.0 / rule.resolution;
    const auto rings = static_cast<std::int32_t>(rule.half), side = 2 * rings;
    const auto rays = static_cast<std::int32_t>(side_rays);
    for (Index i = 0; i < count; ++i) {
        const auto k = static_cast<std::size_t>(i);
        out.x[k] = static_cast<double>(scan.points(begin + i, 0)) * scale;
        out.y[k] = static_cast<double>(scan.points(begin + i, 1)) * scale;
    }
    const float* height = &scan.height[begin];
    const std::int32_t* sector = &scan.sector[begin];
    const bool* airborne = &scan.airborne[begin];
    for (std::size_t i = 0; i < static_cast<std::size_t>(count); ++i) {
        const double x = out.x[i], y = out.y[i];
        const bool ahead = std::abs(x) >= std::abs(y);
        const double lead = ahead ? x : y, beside = ahead ? y : -x;
        const double far = std::abs(lead);
        const bool near = (0.0 < far) & (far < half);
        const bool inside = near & ((sector[i] >= 0) | (height[i] == height[i])) & !airborne[i];
        const double within = near ? 1.0 : 0.0;  // numbers that are not used stay small
        const auto row = std::min(static_cast<std::int32_t>((y + half) * within), side - 1);
        const auto column = std::min(static_cast<std::int32_t>((x + half) * within), side - 1);
        const double across = (beside * within / (near ? lead : 1.0) + 1.0) * (0.5 * side_rays);
        const std::int32_t turn = std::min(static_cast<std::int32_t>(across), rays - 1);
        const std::int32_t quarter = (lead > 0.0 ? 0 : 2) + (ahead ? 0 : 1);
        const auto ring = static_cast<std::int32_t>(far * within);
        const std::int32_t ray = quarter * rays + turn;
        out.cell[i] = inside ? row * side + column : -1;
        out.slot[i] = ((ray >> 2) * rings + ring) * 4 + (ray & 3);  // see `slot_of`
    }
}

// Keeps the least of the sectors that points of a cell lie in; -1: none yet.
void meet(std::int32_t& kept, std::int32_t sector) {
    if (sector >= 0 && (kept < 0 || sector < kept)) kept = sector;
}

// Finds the cell of every point, and the lowest points by ray and ring; sums the ground by cell.
void sort_into_cells(const ClassedPoints& scan, const CellRule& rule, const SquareCells& out, Laying& s) {
    Blocks block;
    const Index size = scan.points.shape[0];
    for (Index p = 0; p < size; ++p) {
        const auto i = static_cast<std::size_t>(p % block_points);
        if (i == 0) find_cells(scan, p, std::min(block_points, size - p), rule, block);
        const std::int32_t cell = block.cell[i];
        s.cell[p] = cell;
        if (cell < 0) continue;
        Returns& returns = s.returns[block.slot[i]];
        const float z = scan.points(p, 2), h = scan.height[p];
        if (scan.ground[p]) {
            s.count[cell] += 1.0;
            s.total[cell] += exact(z);
            meet(out.sector[cell], scan.sector[p]);
        } else {
            s.has_others[cell] = 1;
        }
        if (scan.ground[p] || std::abs(h) < rule.belly) {
            const auto sector = static_cast<float>(scan.sector[p]);
            if (z < returns.ground || (z == returns.ground && sector < returns.sector)) {
                returns.ground = z;
                returns.sector = sector;
            }
        } else if (!(h >= rule.height)) {
            returns.lowest = std::min(returns.lowest, z);
            returns.highest = std::min(returns.highest, -z);
        }
    }
}

// ---- The ground of cells, and objects on it ----

// Finds the elevation of the ground in every cell, its steps, and the level from which objects are measured.
void level_cells(const CellRule& rule, const SquareCells& out, Laying& s) {
    const Index side = rule.side();
    const auto has_ground = [&s](Index cell) { return s.count[cell] > 0.0; };
    for (Index cell = 0; cell < side * side; ++cell) {
        s.level[cell] = has_ground(cell) ? s.total[cell] / s.count[cell] : std::numeric_limits<double>::quiet_NaN();
        out.elevation[cell] = static_cast<float>(s.level[cell]);
    }
    for (Index cell = 0; cell < side * side; ++cell) {
        if (has_ground(cell)) {
            float step = 0.0F;
            const auto compare = [&](Index other) {
                if (has_ground(other)) step = std::max(step, std::abs(out.elevation[other] - out.elevation[cell]));
            };
            if (cell >= side) compare(cell - side);
            if (cell < side * (side - 1)) compare(cell + side);
            if (cell % side > 0) compare(cell - 1);
            if (cell % side < side - 1) compare(cell + 1);
            out.step[cell] = step;
        } else if (s.has_others[cell] != 0) {
            double height = 0.0, count = 0.0;
            const Index row = cell / side, column = cell % side;
            for (Index r = std::max(row - 1, Index{0}); r < std::min(row + 2, side); ++r) {
                for (Index c = std::max(column - 1, Index{0}); c < std::min(column + 2, side); ++c) {
                    if (!has_ground(r * side + c)) continue;
                    count += 1.0;
                    height += out.elevation[r * side + c];
                }
            }
            s.level[cell] = height / count;
        }
    }
}

// Finds the objects on the ground of every cell, and those that hang over it. An obstacle is one above the ground in
// the cell, or above that of its sector.
void stand_objects(const ClassedPoints& scan, const CellRule& rule, const SquareCells& out, Laying& s) {
    for (Index i = 0; i < scan.points.shape[0]; ++i) {
        const Index cell = s.cell[i];
        if (cell < 0 || scan.ground[i]) continue;
        double h = scan.height[i];
        const double near = scan.points(i, 2) - s.level[cell];
        if (!(std::isnan(near) || (rule.belly <= h && h < rule.height))) h = near;
        if (std::isnan(h)) {
            s.stands[cell] = 1;
        } else if (h >= rule.height) {
            float& clearance = out.clearance[cell];
            const auto above = static_cast<float>(h);
            clearance = std::isnan(clearance) ? above : std::min(clearance, above);
        } else if (h >= rule.belly) {
            s.stands[cell] = 1;
            const auto top = static_cast<float>(h);
            const float tip = scan.points(i, 2);
            if (!(top <= out.top[cell]) || (top == out.top[cell] && tip > out.tip[cell])) {
                out.top[cell] = top;
                out.tip[cell] = tip;
            }
        } else if (h > -rule.belly && !(s.count[cell] > 0.0)) {
            meet(out.sector[cell], scan.sector[i]);
        }
    }
}

// ---- Rays ----

// Follows the ground outwards along a ray: finds where it goes on between returns, and where it drops.
class RayFollower {
  public:
    // `x`, `y`: the way from ring to ring, m.
    RayFollower(Index ray, double x, double y, const ClassedPoints& scan, const CellRule& rule, Laying& s)
        : ray_(ray), x_(x), y_(y), scan_(scan), rule_(rule), s_(s), object_(-rule.half) {}

    void follow() {
        for (Index ring = 0; ring < rule_.half; ++ring) {
            const auto [at, returns] = returns_of(ring);
            if (returns.ground != nothing) {
                const auto here = static_cast<Index>(returns.sector);
                connect(ring, false, returns.ground, here);
                enter_ground(ring, at, returns.ground, here);
            }
            if (returns.lowest != nothing) {
                const double above = connect(ring, true, returns.lowest, home_);
                if (last_ >= 0 && rule_.belly <= above && above < rule_.height) enter_object(ring, returns);
            }
        }
    }

  private:
    struct Found {
        Index ray;
        Returns returns;
    };

    // A return that is missing is that of a ray beside it.
    Found returns_of(Index ring) const {
        Found found{ray_, {}};
        for (const Index turn : {Index{0}, all_rays - 1, Index{1}}) {
            found.ray = (ray_ + turn) % all_rays;
            found.returns = s_.returns[slot_of(found.ray, ring, rule_.half)];
            if (std::min(found.returns.ground, found.returns.lowest) < nothing) break;
        }
        return found;
    }

    std::int32_t& seen(Index ring) const { return s_.seen[ray_ * rule_.half + ring]; }

    // Marks the rings between the last ground and a return at height z [m]: the ground drops, or it goes on, and no
    // obstacle before them hides what may stand there. Returns how far the return lies above that ground, m.
    double connect(Index ring, bool is_object, double z, Index here) {
        if (last_ < 0) return 0.0;
        const auto way = static_cast<double>(ring - last_);
        const double away = static_cast<double>(ring) + 0.5, from = static_cast<double>(last_) + 0.5;
        const double above = z - level_ - scan_.rise(home_, x_, y_) * way;
        const double under = z - level_ - scan_.rise(-1, x_, y_) * way;  // against the slope of the whole ground
        const bool drops = scan_.drops[scan_.row(home_)] || scan_.drops[scan_.row(here)];
        if ((drops ? std::min(above, under) : above) < -rule_.belly && under < -0.5 * rule_.belly) {
            if (drops)
                for (Index k = last_; k < ring + (is_object ? 1 : 0); ++k) seen(k) = falls;
        } else if ((!is_object || above < rule_.height) && z * from / away - level_ < rule_.belly) {
            for (Index k = last_ + 1; k < ring; ++k)
                if (shadow_ * (static_cast<double>(k) + 0.5) - level_ < rule_.belly)
                    seen(k) = static_cast<std::int32_t>(2 * k < last_ + ring ? home_ : here);
        }
        return above;
    }

    void enter_object(Index ring, const Returns& returns) {
        const double away = static_cast<double>(ring) + 0.5, slope = returns.lowest / away;
        shadow_ = std::max(shadow_, -returns.highest / away);
        under_ = ring - object_ > rule_.beneath ? slope : std::min(under_, slope);
        object_ = ring;
    }

    void enter_ground(Index ring, Index at, double z, Index here) {
        const double away = static_cast<double>(ring) + 0.5;
        last_ = ring;
        level_ = z;
        home_ = here;
        const bool dark = shadow_ * away - level_ >= rule_.belly;
        const bool beneath = dark && ring - object_ <= rule_.beneath && z / away < under_;
        if (seen(ring) != falls && (at == ray_ || !dark))
            seen(ring) = beneath ? beneath_object : static_cast<std::int32_t>(here);
    }

    const Index ray_;
    const double x_, y_;
    const ClassedPoints& scan_;
    const CellRule& rule_;
    Laying& s_;
    Index last_ = -1, home_ = -1;                               // ring of the last ground, and its sector
    double level_ = 0.0;                                        // its height, m
    Index object_;                                              // ring of the last obstacle
    double under_ = std::numeric_limits<double>::infinity();    // z per ring of the beams below and above
    double shadow_ = -std::numeric_limits<double>::infinity();  // the obstacles so far
};

// ---- Cells ----

// The place of a cell in bins, outwards and around; the first and the last ray through it, and its ring: those hold the
// cells of one distance along x or y.
struct CellPlace {
    std::int32_t outwards, around, first, last, ring;
};

// Finds the places of the cells of a row, without a branch: several at once.
void find_row(Index row, const BinRings& rings, const CellRule& rule, Scratch<CellPlace>& out) {
    const double up = static_cast<double>(row) + 0.5, half = static_cast<double>(rule.half), y = up - half;
    for (Index column = 0; column < out.count(); ++column) {
        const double right = static_cast<double>(column) + 0.5, x = right - half;
        const auto axis = [&](Index k) {
            return rule.to_sensor(k, 0) * right + rule.to_sensor(k, 1) * up + rule.to_sensor(k, 2);
        };
        const double east = axis(0), north = axis(1), turn = full_turn(turn_of(east, north));
        const bool ahead = std::abs(x) >= std::abs(y);
        const double lead = ahead ? x : y, beside = ahead ? y : -x, far = std::abs(lead);
        const double across = lead > 0.0 ? beside : -beside;
        const auto ray = [&](double edge) {
            const double place = ((across + edge) / far + 1.0) * (0.5 * side_rays);
            return static_cast<std::int32_t>(std::clamp(place, 0.0, static_cast<double>(side_rays)));
        };
        const auto begin = static_cast<std::int32_t>(side_rays * ((lead > 0.0 ? 0 : 2) + (ahead ? 0 : 1)));
        const std::int32_t first = ray(-0.5);
        out[column] = {
            rings.parts(east * east + north * north),
            static_cast<std::int32_t>(turn * static_cast<double>(bin_columns * bin_parts)), begin + first,
            begin + std::max(ray(0.5) - 1, first), static_cast<std::int32_t>(far)};
    }
}

// Finds the kind of a cell, and the sector whose ground is known there.
void judge_cell(
    Index cell, const CellPlace& place, const ClassField& field, const ClassedPoints& scan, const CellRule& rule,
    const SquareCells& out, const Laying& s) {
    const auto [outwards, around, first, last, ring] = place;
    Index seen = 0, beneath = 0;
    bool drops = false;
    std::int32_t home = -1;
    for (Index ray = first; ray <= last; ++ray) {
        const std::int32_t sector = s.seen[ray * rule.half + ring];
        drops |= sector == falls;
        beneath += sector == beneath_object;
        if (sector < 0) continue;
        ++seen;
        if (home < 0 || 2 * ray <= first + last) home = sector;
    }
    if (out.sector[cell] < 0 && 2 * seen > last - first) out.sector[cell] = home;
    if (beneath > seen) out.sector[cell] = -1;
    const Index of = scan.row(out.sector[cell]);
    const auto barred = static_cast<std::uint8_t>(scan.kind[scan.row(-1)] - 1);
    const bool stops = s.stands[cell] != 0 || drops || out.step[cell] > rule.belly;
    const std::uint8_t kind = stops ? barred : scan.kind[of];
    std::uint8_t class_id = scan.class_id[of];
    if (class_id < barred) {
        const std::uint8_t found = field.at(outwards, around);
        if (found != field.unknown) class_id = found;
    }
    out.class_id[cell] = class_id;
    out.kind[cell] = kind < barred ? class_id : kind;
}

// Finds the ground of every cell, the objects on it and over it, and its kind. `out` comes as it is without a
// point: heights NaN, rows -1.
void lay_cells(ClassedPoints scan, ZoneGrid grid, ClassField field, CellRule rule, SquareCells out) {
    Laying& s = kept_memory<Laying>();
    s.renew_all(scan.points.shape[0], rule.half);
    sort_into_cells(scan, rule, out, s);
    level_cells(rule, out, s);
    stand_objects(scan, rule, out, s);
    for (Index ray = 0; ray < all_rays; ++ray) {
        const double across = (static_cast<double>(ray % side_rays) + 0.5) / (0.5 * side_rays) - 1.0;
        const double ahead = ray < 2 * side_rays ? rule.resolution : -rule.resolution;
        const bool along_x = ray / side_rays % 2 == 0;
        RayFollower(ray, along_x ? ahead : -ahead * across, along_x ? ahead * across : ahead, scan, rule, s).follow();
    }
    const BinRings rings(grid);
    Scratch<CellPlace> places(rule.side());
    for (Index cell = 0; cell < out.kind.size(); ++cell) {
        const Index column = cell % rule.side();
        if (column == 0) find_row(cell / rule.side(), rings, rule, places);
        judge_cell(cell, places[column], field, scan, rule, out, s);
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::SquareCells, kind, class_id, sector, elevation, step, top, clearance, tip)
BUMPY_RECORD(bumpy::ClassedPoints, points, ground, airborne, height, sector, kind, class_id, drops, slope)
BUMPY_RECORD(bumpy::CellRule, resolution, half, belly, height, beneath, to_sensor)

BUMPY_LOOPS(cells, lay_cells)
