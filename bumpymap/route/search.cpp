// Ways over a window: the cost of lines and their distance to closed tiles, how a line is pulled tight, and the
// cheapest ways from tile to tile. Ours; see search.py, which explains the arrays and has the same numbers.
#include <nanobind/stl/pair.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <queue>
#include <utility>
#include <vector>

#include "bumpytiles/bindings.hpp"

namespace bumpy {
namespace {

// ---- Straight lines over square tiles: their cost, their distance to closed tiles ----
//
// Field coordinates (r, c) of a window are in tiles: r from its north edge southwards, c from its west edge eastwards.
// A tile is closed where its cost is infinite; everything outside the window is closed. What climbing, descending and
// driving across a slope cost is added for the very direction of the segment; the cost of a direction that is too steep
// across is infinite.

constexpr double infinite = std::numeric_limits<double>::infinity();
// Pieces below this length, tiles, are rounding errors of a line through a corner of four tiles.
constexpr double sliver = 1e-12;
// Distances to closed tiles may be shorter than the margin by this, tiles, but not by more than half of it.
constexpr double rounding = 1e-9;
// Bits: which end of a segment is the start or the goal, and may be nearer to closed tiles than the margin.
constexpr int a_end = 1;
constexpr int b_end = 2;

// A direction: southwards and eastwards in a length of 1; 0 if there is none.
struct Heading {
    double down, right;
};

struct Point {
    double r, c;
};

struct Costs {
    Array<const float, 2> tiles;
    Array<const float, 3> gradient;
    double climb, descent, side, steepest;

    // The share of a gradient southwards and eastwards in the cost, in a direction; infinite if it is barred.
    double of_slope(double south, double east, const Heading& heading) const {
        const auto [down, right] = heading;
        const double rise = south * down + east * right, across = std::abs(south * right - east * down);
        if (across > steepest) return infinite;
        return (rise > 0.0 ? climb * rise : -descent * rise) + side * across;
    }

    bool inside(Index row, Index col) const {
        return row >= 0 && col >= 0 && row < tiles.shape[0] && col < tiles.shape[1];
    }

    bool open(Index row, Index col) const { return inside(row, col) && tiles(row, col) < infinite; }

    // The cost of a tile in a direction; infinite outside the window.
    double of(const Heading& heading, Index row, Index col) const {
        if (!inside(row, col)) return infinite;
        const double total = tiles(row, col);
        return gradient.shape[0] > 0 ? total + of_slope(gradient(row, col, 0), gradient(row, col, 1), heading) : total;
    }

    // Rows and columns back to the tile that counts where a line runs on the border of two: the dearer one. `r` is the
    // row of a line that keeps it, NaN otherwise; `c` likewise.
    std::array<Index, 2> dearer_shift(const Heading& heading, Point along, Index row, Index col) const {
        const double here = of(heading, row, col);
        if (along.r == static_cast<double>(row) && of(heading, row - 1, col) > here) return {1, 0};
        if (along.c == static_cast<double>(col) && of(heading, row, col - 1) > here) return {0, 1};
        return {0, 0};
    }
};

// The direction of a step of that length.
Heading heading_of(double dr, double dc, double length) {
    return length > 0.0 ? Heading{dr / length, dc / length} : Heading{0.0, 0.0};
}

// The row or column that a line keeps, NaN where it does not.
Point kept_by(Point a, double dr, double dc) {
    constexpr double none = std::numeric_limits<double>::quiet_NaN();
    return {dr == 0.0 ? a.r : none, dc == 0.0 ? a.c : none};
}

// The tile, along one axis, that a line enters when it leaves `a` in the direction of `delta`.
Index first_tile(double a, double delta) {
    const double tile = std::floor(a);
    return static_cast<Index>(tile) - (delta < 0.0 && tile == a);
}

// The share of a line after which it leaves the tile, along one axis; large if never.
double crossing(double a, double delta, Index tile) {
    return delta == 0.0 ? 2.0 : (static_cast<double>(tile + (delta > 0.0)) - a) / delta;
}

// The exact integral of the cost along a segment; infinite as soon as it passes `limit`. Where the segment runs along a
// border, the dearer of both tiles counts.
double segment_cost(const Costs& cost, Point a, Point b, double limit) {
    const double dr = b.r - a.r, dc = b.c - a.c, length = std::sqrt(dr * dr + dc * dc);
    const Heading heading = heading_of(dr, dc, length);
    Index row = first_tile(a.r, dr), col = first_tile(a.c, dc);
    const double north = static_cast<double>(row), west = static_cast<double>(col);
    const bool keeps = dr == 0.0 || dc == 0.0;
    if (north <= b.r && b.r <= north + 1.0 && west <= b.c && b.c <= west + 1.0 && !keeps) {  // all in one tile
        const double total = length > sliver ? length * cost.of(heading, row, col) : 0.0;
        return total <= limit ? total : infinite;
    }
    double next_r = crossing(a.r, dr, row), next_c = crossing(a.c, dc, col), total = 0.0, t = 0.0;
    while (true) {
        const double end = std::min({next_r, next_c, 1.0}), piece = (end - t) * length;
        if (piece > sliver) {
            const std::array<Index, 2> back =
                keeps ? cost.dearer_shift(heading, kept_by(a, dr, dc), row, col) : std::array<Index, 2>{};
            total += piece * cost.of(heading, row - back[0], col - back[1]);
            if (!(total <= limit)) return infinite;
        }
        if (end >= 1.0) return total;
        if (next_r <= end) {
            row += dr > 0.0 ? 1 : -1;
            next_r = crossing(a.r, dr, row);
        }
        if (next_c <= end) {
            col += dc > 0.0 ? 1 : -1;
            next_c = crossing(a.c, dc, col);
        }
        t = std::max(t, end);
    }
}

// The distance of a point to a tile; 0 in it.
double to_tile(Point a, Index row, Index col) {
    const double north = static_cast<double>(row), west = static_cast<double>(col);
    const double dr = std::max({north - a.r, a.r - north - 1.0, 0.0});
    const double dc = std::max({west - a.c, a.c - west - 1.0, 0.0});
    return std::sqrt(dr * dr + dc * dc);
}

// Narrows the shares [first, last] of a segment to those between two borders of an axis; false where none is.
bool clip(double a, double delta, double low, double high, double& first, double& last) {
    if (delta == 0.0) return a >= low && a <= high;
    const double t0 = (low - a) / delta, t1 = (high - a) / delta;
    first = std::max(first, std::min(t0, t1));
    last = std::min(last, std::max(t0, t1));
    return true;
}

// The distance of a segment to a tile: that of an end to the tile, or of a corner of the tile to the segment.
double gap(Point a, Point b, Index row, Index col) {
    const double north = static_cast<double>(row), west = static_cast<double>(col);
    const double dr = b.r - a.r, dc = b.c - a.c;
    double first = 0.0, last = 1.0;
    const bool meets = clip(a.r, dr, north, north + 1.0, first, last) && clip(a.c, dc, west, west + 1.0, first, last);
    if (meets && first <= last) return 0.0;
    const double square = dr * dr + dc * dc;
    double least = std::min(to_tile(a, row, col), to_tile(b, row, col));
    if (square == 0.0) return least;
    for (const auto& corner :
         {Point{north, west}, {north, west + 1.0}, {north + 1.0, west}, {north + 1.0, west + 1.0}}) {
        double r = corner.r - a.r, c = corner.c - a.c;
        const double t = std::min(std::max((r * dr + c * dc) / square, 0.0), 1.0);
        r -= t * dr;
        c -= t * dc;
        least = std::min(least, std::sqrt(r * r + c * c));
    }
    return least;
}

// True if a distance is nearer than a margin allows.
bool too_near(double distance, double margin) { return distance < margin - std::min(rounding, 0.5 * margin); }

// True if a segment keeps a margin from all closed tiles. From a tile that an end in `ends` is nearer to, it need not
// keep more than that end does.
bool segment_clear(const Costs& cost, Point a, Point b, double margin, int ends) {
    const double dr = b.r - a.r, dc = b.c - a.c;
    const auto tile = [](double place) { return static_cast<Index>(std::floor(place)); };
    const Index south = tile(std::max(a.r, b.r) + margin);
    for (Index row = tile(std::min(a.r, b.r) - margin); row <= south; ++row) {
        const double r = static_cast<double>(row);
        double first = 0.0, last = 1.0;
        clip(a.r, dr, r - margin, r + 1.0 + margin, first, last);
        const double c0 = a.c + first * dc, c1 = a.c + last * dc;
        const Index east = tile(std::max(c0, c1) + margin);
        for (Index col = tile(std::min(c0, c1) - margin); col <= east; ++col) {
            if (cost.open(row, col)) continue;
            double need = margin;
            if (ends & a_end) need = std::min(need, to_tile(a, row, col));
            if (ends & b_end) need = std::min(need, to_tile(b, row, col));
            if (too_near(gap(a, b, row, col), need)) return false;
        }
    }
    return true;
}

Point point_at(Array<const double, 2> points, Index i) { return {points(i, 0), points(i, 1)}; }

// ---- Pulling tight: corners are left out, moved off the borders of tiles, and moved by ever smaller steps ----
//
// Every cost is the exact integral.

constexpr Index directions_of_turn = 8;

// The corners of a line, by how far each is moved next, and the cost from the corner before to each, tiles.
struct Corners {
    Array<double, 2> points;
    std::vector<double> step, spent;
};

struct TracedLine {
    Array<Index> row, col;
    Array<double> length;
    Array<Index> part;
};

double sum_cost(Costs cost, Array<const double, 2> points) {
    double total = 0.0;
    for (Index i = 0; i + 1 < points.shape[0]; ++i)
        total += segment_cost(cost, point_at(points, i), point_at(points, i + 1), infinite);
    return total;
}

// Bits of those of two corners that are the start or the goal of a line.
int ends_of(Index a, Index b, Index count) { return (a == 0 ? a_end : 0) | (b == count - 1 ? b_end : 0); }

// True if a line keeps a margin; its first and last point may be nearer to closed tiles.
bool check_clear(Costs cost, Array<const double, 2> points, double margin) {
    const Index count = points.shape[0];
    for (Index i = 0; i + 1 < count; ++i) {
        const Point a = point_at(points, i), b = point_at(points, i + 1);
        if (!segment_clear(cost, a, b, margin, ends_of(i, i + 1, count))) return false;
        if (!(segment_cost(cost, a, b, infinite) < infinite)) return false;
    }
    return true;
}

// Cuts a line at the borders of tiles, into the pieces that `segment_cost` sums; returns their number.
Index trace_line(Costs cost, Array<const double, 2> points, TracedLine out) {
    Index n = 0;
    for (Index i = 0; i + 1 < points.shape[0]; ++i) {
        const Point a = point_at(points, i), b = point_at(points, i + 1);
        const double dr = b.r - a.r, dc = b.c - a.c, length = std::sqrt(dr * dr + dc * dc);
        const Heading heading = heading_of(dr, dc, length);
        Index row = first_tile(a.r, dr), col = first_tile(a.c, dc);
        for (double t = 0.0; t < 1.0;) {
            const double next_r = crossing(a.r, dr, row), next_c = crossing(a.c, dc, col);
            const double end = std::min({next_r, next_c, 1.0});
            if ((end - t) * length > sliver) {
                const auto [up, left] = cost.dearer_shift(heading, kept_by(a, dr, dc), row, col);
                // On the window's edge the tile inside it counts.
                out.row[n] = std::clamp(row - up, Index{0}, cost.tiles.shape[0] - 1);
                out.col[n] = std::clamp(col - left, Index{0}, cost.tiles.shape[1] - 1);
                out.length[n] = (end - t) * length;
                out.part[n++] = i;
            }
            if (next_r <= end) row += dr > 0.0 ? 1 : -1;
            if (next_c <= end) col += dc > 0.0 ? 1 : -1;
            t = std::max(t, end);
        }
    }
    return n;
}

// Fills the cost up to each of n corners, and the one before it, of the cheapest line through some of them.
void choose(
    const Costs& cost, double margin, double worth, Array<const double, 2> points, Index n, Index skips,
    std::vector<double>& best, std::vector<Index>& before) {
    best[0] = 0.0;
    before[0] = 0;
    for (Index j = 1; j < n; ++j) {
        const Point b = point_at(points, j);
        best[j] = best[j - 1] + segment_cost(cost, point_at(points, j - 1), b, infinite);
        before[j] = j - 1;
        for (Index i = std::max(Index{0}, j - skips); i < j - 1; ++i) {
            const Point a = point_at(points, i);
            // From far to near: what leaves out fewer corners must be cheaper by what the corners are worth.
            const double allowed = before[j] == j - 1 ? worth : -worth;
            const double total = segment_cost(cost, a, b, best[j] + allowed - best[i]);
            if (total < infinite && segment_clear(cost, a, b, margin, ends_of(i, j, n))) {
                best[j] = best[i] + total;
                before[j] = i;
            }
        }
    }
}

// Leaves out corners, until none can be, so that the line through the others in order is the cheapest; returns how many
// stay. At most `skips` - 1 are left out between two of them at once. Of lines that cost nearly the same, that with
// fewer corners wins: corners on straight lines go, and those without which it costs no more than `worth`. The corners
// that stay come first.
Index leave_out(Costs cost, double margin, double worth, Array<double, 2> points, Index skips) {
    Index n = 0, count = points.shape[0];
    std::vector<double> best(count);
    std::vector<Index> before(count), kept;
    while (n != count) {
        n = count;
        choose(cost, margin, worth, points, n, skips, best, before);
        kept.clear();
        for (Index at = n - 1; at > 0; at = before[at]) kept.push_back(at);
        count = 1;  // the first corner stays
        for (auto at = kept.rbegin(); at != kept.rend(); ++at, ++count) {
            points(count, 0) = points(*at, 0);
            points(count, 1) = points(*at, 1);
        }
    }
    return count;
}

// The cost from corner i - 1 over a point to i + 1; infinite above a limit.
double two_segments(const Costs& cost, Array<const double, 2> points, Index i, Point over, double limit) {
    const double first = segment_cost(cost, point_at(points, i - 1), over, limit);
    return first < infinite ? first + segment_cost(cost, over, point_at(points, i + 1), limit - first) : first;
}

// True if the line may go from corner i - 1 over a point to i + 1.
bool two_clear(const Costs& cost, double margin, Array<const double, 2> points, Index i, Point over) {
    const Index n = points.shape[0];
    return segment_clear(cost, point_at(points, i - 1), over, margin, i == 1 ? a_end : 0) &&
           segment_clear(cost, over, point_at(points, i + 1), margin, i == n - 2 ? b_end : 0);
}

// Moves corners that are `near` to borders of tiles by `shift` from them, to where the line costs least, tiles.
void leave_borders(Costs cost, Array<double, 2> points, double near, double shift) {
    for (Index i = 1; i + 1 < points.shape[0]; ++i) {
        const Point from = point_at(points, i);
        const double row = std::floor(from.r + 0.5), col = std::floor(from.c + 0.5);
        const bool on_row = std::abs(from.r - row) < near, on_col = std::abs(from.c - col) < near;
        double least = infinite;
        for (int k = 0; k < 4; ++k) {
            const bool south = k > 1, east = k % 2 == 1;
            if (!(on_row || on_col) || (south && !on_row) || (east && !on_col)) continue;
            const Point to{
                on_row ? row + (south ? shift : -shift) : from.r, on_col ? col + (east ? shift : -shift) : from.c};
            const double total = two_segments(cost, points, i, to, infinite);
            if (total < least) {
                least = total;
                points(i, 0) = to.r;
                points(i, 1) = to.c;
            }
        }
    }
}

// Fills the cost from a corner's predecessor to it.
void spend(const Costs& cost, Corners& corners, Index i) {
    corners.spent[i] = segment_cost(cost, point_at(corners.points, i - 1), point_at(corners.points, i), infinite);
}

// Moves a corner to the best of ten places around it: eight directions, and the borders nearest to it.
bool move_corner(
    const Costs& cost, double margin, double gain, Corners& corners, Array<const double, 2> directions, Index i) {
    const double step = corners.step[i];
    const Point from = point_at(corners.points, i);
    double best = corners.spent[i] + corners.spent[i + 1] - gain;
    bool moved = false;
    for (Index k = 0; k < directions_of_turn + 2; ++k) {
        Point to = from;
        if (k < directions_of_turn) {
            to.r += step * directions(k, 0);
            to.c += step * directions(k, 1);
        } else {
            double& axis = k == directions_of_turn ? to.r : to.c;
            axis = std::floor(axis + 0.5);
            if (std::abs(to.r - from.r) + std::abs(to.c - from.c) > 2.0 * step) continue;
        }
        const double total = two_segments(cost, corners.points, i, to, best);
        if (total < best && two_clear(cost, margin, corners.points, i, to)) {
            best = total;
            moved = true;
            corners.points(i, 0) = to.r;  // the places that follow are still those around the old one
            corners.points(i, 1) = to.c;
        }
    }
    if (moved) {
        spend(cost, corners, i);
        spend(cost, corners, i + 1);
    }
    return moved;
}

// Moves corners in turn, for a gain of at least that, until no step helps any of them, at most `sweeps` times all of
// them. `directions` (8 k, 2): unit vectors; the next eight are tried whenever the last did not help. Steps are halved
// from the first down to the least, tiles.
void move_corners(
    Costs cost, double margin, double gain, Array<double, 2> points, Array<const double, 2> directions,
    double first_step, double least_step, Index sweeps) {
    const Index n = points.shape[0], turns = directions.shape[0] / directions_of_turn;
    Corners corners{points, std::vector<double>(n, first_step), std::vector<double>(n)};
    for (Index i = 1; i < n; ++i) spend(cost, corners, i);
    bool active = true;
    for (Index turn = 0; turn < sweeps && active; ++turn) {
        active = false;
        for (Index i = 1; i < n - 1; ++i) {
            if (corners.step[i] < least_step) continue;
            active = true;
            const Index tried = turn % turns * directions_of_turn;
            if (!move_corner(cost, margin, gain, corners, directions.slice(tried, tried + directions_of_turn), i)) {
                corners.step[i] *= 0.5;
                continue;
            }
            // A step that helped is tried again, a longer one too; and the neighbours may now find something.
            corners.step[i] = std::min(2.0 * corners.step[i], 1.0);
            for (const Index near : {i - 1, i + 1})
                corners.step[near] = std::max(corners.step[near], 0.25 * corners.step[i]);
        }
    }
}

// ---- The search, from tile to tile: A* ----
//
// The window is flattened row by row and has a ring of closed tiles as wide as the longest move, so that no move has to
// look where the window ends. Moves are many and most come too near to a closed tile, or lead to tiles that are settled
// or have been reached for less than the move costs at least: all that is asked before the integral over its tiles.
// Closed tiles around the start of a move are the bits of two numbers, as are the tiles that must be open for it.

// In place of a move: straight from the start.
constexpr std::uint8_t from_start = 254;
// Tiles that a move goes at most, along each axis.
constexpr Index reach = 4;

struct MoveTables {
    Array<const Index> step;
    Array<const double> length, end;
    Array<const Index> first_piece, piece;
    Array<const double> piece_length;
    Array<const double, 2> direction;
    Array<const Index> near_north, near_south;
};

struct Ground {
    Costs cost;
    Array<const std::uint8_t> closed;
    Index start;
    double goal_row, goal_col, least, bound;

    Index width() const { return cost.tiles.shape[1]; }

    // The least cost from the middle of a tile to the goal.
    double to_goal(Index tile) const {
        if (bound == 0.0) return 0.0;
        const Index row = tile / width();
        const double dr = static_cast<double>(row) + 0.5 - goal_row;
        const double dc = static_cast<double>(tile - row * width()) + 0.5 - goal_col;
        return bound * std::sqrt(dr * dr + dc * dc);
    }

    // The closed tiles in some rows around a tile: nine bits a row, the first row's the highest.
    Index closed_around(Index tile, Index first, Index last) const {
        constexpr Index bits = 2 * reach + 1;
        Index found = 0;
        for (Index row = first; row < last; ++row) {
            const Index at = tile + row * width() - reach;
            const Index two = closed[at >> 3] | Index{closed[(at >> 3) + 1]} << 8;
            found = found << bits | ((two >> (at & 7)) & ((1 << bits) - 1));
        }
        return found;
    }
};

struct Search {
    const Ground& ground;
    const MoveTables& moves;
    const Array<const double, 2> enter, leave;
    double best;
    const Array<double> g;
    const Array<std::uint8_t> back;
    const Array<bool> settled;
    Index last = -1;

    // Tiles by what a way over them costs at least, the cheapest first; a tile stands there once for each cheaper way.
    using Waiting = std::pair<double, std::int32_t>;
    // gcc asks for the braces.
    // NOLINTNEXTLINE(readability-redundant-member-init)
    std::priority_queue<Waiting, std::vector<Waiting>, std::greater<>> waiting{};

    // The cost of an open tile in the direction of a move.
    double cost_of(Index k, Index tile) const {
        const double total = ground.cost.tiles.data[tile];
        if (ground.cost.gradient.shape[0] == 0) return total;
        const float* const slope = ground.cost.gradient.data + 2 * tile;
        return total + ground.cost.of_slope(slope[0], slope[1], {moves.direction(k, 0), moves.direction(k, 1)});
    }

    // The exact integral of the cost along a move; infinite if it cannot be below the limit.
    double move_cost(Index k, Index tile, double limit) const {
        double total = moves.end[k] * cost_of(k, tile);
        total += moves.end[k] * cost_of(k, tile + moves.step[k]);
        if (total + (moves.length[k] - 2.0 * moves.end[k]) * ground.least >= limit) return infinite;
        for (Index i = moves.first_piece[k]; i < moves.first_piece[k + 1]; ++i)
            total += moves.piece_length[i] * cost_of(k, tile + moves.piece[i]);
        return total;
    }

    // Takes a cheaper way to a tile, unless the goal is too far behind it.
    void offer(Index tile, double cost, std::uint8_t move) {
        const double key = cost + ground.to_goal(tile);
        if (key >= best) return;
        g[tile] = cost;
        back[tile] = move;
        waiting.emplace(key, static_cast<std::int32_t>(tile));
    }

    // Sees whether the goal is reached for less by going straight there from a tile.
    void try_exit(Index tile) {
        const Index half = leave.shape[0] / 2, row = tile / ground.width();
        const Index r = row - static_cast<Index>(std::floor(ground.goal_row)) + half;
        const Index c = tile - row * ground.width() - static_cast<Index>(std::floor(ground.goal_col)) + half;
        if (r < 0 || r > 2 * half || c < 0 || c > 2 * half) return;
        const double total = g[tile] + leave(r, c);
        if (total < best) {
            best = total;
            last = tile;
        }
    }

    // Settles tiles from the start on until no way that is open can be cheaper than the best to the goal.
    void run() {
        const Index half = enter.shape[0] / 2;
        for (Index i = 0; i < enter.shape[0]; ++i)
            for (Index j = 0; j < enter.shape[1]; ++j)
                if (enter(i, j) < infinite)
                    offer(ground.start + (i - half) * ground.width() + j - half, enter(i, j), from_start);
        while (!waiting.empty() && waiting.top().first < best) {
            const Index tile = waiting.top().second;
            waiting.pop();
            if (settled[tile]) continue;
            settled[tile] = true;
            try_exit(tile);
            const Index north = ground.closed_around(tile, -reach, 1);
            const Index south = ground.closed_around(tile, 1, reach + 1);
            for (Index k = 0; k < moves.step.size(); ++k) {
                const Index to = tile + moves.step[k];
                if ((north & moves.near_north[k]) || (south & moves.near_south[k]) || settled[to]) continue;
                const double total = g[tile] + move_cost(k, tile, g[to] - g[tile]);
                if (total < g[to]) offer(to, total, static_cast<std::uint8_t>(k));
            }
        }
    }
};

// Fills what is reached: costs from the start, the moves that led there, and whether these are final.
// Returns the tile from which the way goes straight to the goal, -1 if the known way is the best, and the cost. `enter`
// and `leave` (m, m): costs straight from the start to the tiles around it, and from those around the goal to it;
// `best`: that of a way that is known.
std::pair<Index, double> search_ways(
    Ground ground, MoveTables moves, Array<const double, 2> enter, Array<const double, 2> leave, double best,
    Array<double> g, Array<std::uint8_t> back, Array<bool> settled) {
    Search search{ground, moves, enter, leave, best, g, back, settled};
    search.run();
    return {search.last, search.best};
}

// Fills (m, m) costs from a start or goal to the middles of the tiles around it; infinite if not clear.
void connect(Costs cost, double r, double c, double margin, Array<double, 2> out) {
    const Index half = out.shape[0] / 2;
    const Index top = static_cast<Index>(std::floor(r)) - half, left = static_cast<Index>(std::floor(c)) - half;
    for (Index i = 0; i < out.shape[0]; ++i) {
        for (Index j = 0; j < out.shape[1]; ++j) {
            out(i, j) = infinite;
            if (!cost.open(top + i, left + j)) continue;
            const Point middle{static_cast<double>(top + i) + 0.5, static_cast<double>(left + j) + 0.5};
            const double found = segment_cost(cost, {r, c}, middle, infinite);
            if (found < infinite && segment_clear(cost, {r, c}, middle, margin, a_end)) out(i, j) = found;
        }
    }
}

// Fills (n, rows, cols): which tiles are nearer than a margin to the segments from the first point to each other.
void find_near(Array<const double, 2> points, double margin, Array<bool, 3> out) {
    for (Index k = 0; k < out.shape[0]; ++k)
        for (Index row = 0; row < out.shape[1]; ++row)
            for (Index col = 0; col < out.shape[2]; ++col)
                out(k, row, col) = too_near(gap(point_at(points, 0), point_at(points, k + 1), row, col), margin);
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::Costs, tiles, gradient, climb, descent, side, steepest)
BUMPY_RECORD(bumpy::TracedLine, row, col, length, part)
BUMPY_RECORD(bumpy::MoveTables, step, length, end, first_piece, piece, piece_length, direction, near_north, near_south)
BUMPY_RECORD(bumpy::Ground, cost, closed, start, goal_row, goal_col, least, bound)

BUMPY_LOOPS(
    search, sum_cost, check_clear, trace_line, leave_out, leave_borders, move_corners, search_ways, connect, find_near)
