// The cost of a line over a map, its distance to closed tiles, and how it is pulled tight: corners are left
// out, moved off the borders of tiles, and moved by ever smaller steps. Every cost is the exact integral. Ours; see
// search.py.
#include "bumpymap/route/lines.hpp"

namespace bumpy {
namespace {

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

// The tile, along one axis, that a line enters when it leaves `a` in the direction of `delta`.
Index first_tile(double a, double delta) {
    const double tile = std::floor(a);
    return static_cast<Index>(tile) - (delta < 0.0 && tile == a);
}

// The share of a line after which it leaves the tile, along one axis; large if never.
double crossing(double a, double delta, Index tile) {
    return delta == 0.0 ? 2.0 : (static_cast<double>(tile + (delta > 0.0)) - a) / delta;
}

// Cuts a line at the borders of tiles, into the pieces that `segment_cost` sums; returns their number.
Index trace_line(Costs cost, Array<const double, 2> points, TracedLine out) {
    Index n = 0;
    for (Index i = 0; i + 1 < points.shape[0]; ++i) {
        const Point a = point_at(points, i), b = point_at(points, i + 1);
        const double dr = b.r - a.r, dc = b.c - a.c, length = std::sqrt(dr * dr + dc * dc);
        const Heading heading = cost.heading(dr, dc, length);
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
    std::vector<Index> before(count);
    while (n != count) {
        n = count;
        count = 1;
        choose(cost, margin, worth, points, n, skips, best, before);
        Index at = n - 1;
        while (at > 0) {  // turn the links round: from each corner that stays to the next one
            const Index previous = before[at];
            best[previous] = static_cast<double>(at);
            at = previous;
            ++count;
        }
        for (Index k = 0; k < count; ++k) {
            points(k, 0) = points(at, 0);
            points(k, 1) = points(at, 1);
            at = k < count - 1 ? static_cast<Index>(best[at]) : 0;
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

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::TracedLine, row, col, length, part)

BUMPY_LOOPS(straighten, sum_cost, check_clear, trace_line, leave_out, leave_borders, move_corners)
