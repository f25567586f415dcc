// The cheapest ways over a window, from tile to tile: A*. The window is flattened row by row and has a ring of closed
// tiles as wide as the longest move, so that no move has to look where the window ends. Moves are many and most come
// too near to a closed tile, or lead to tiles that are settled or have been reached for less than the move costs at
// least: all that is asked before the integral over its tiles. Closed tiles around the start of a move are the bits of
// two numbers, as are the tiles that must be open for it. Ours; see search.py, which explains the arrays and has the
// same numbers.
#include <nanobind/stl/pair.h>

#include <functional>
#include <queue>
#include <utility>
#include <vector>

#include "bumpymap/route/lines.hpp"

namespace bumpy {
namespace {

// In place of a move: straight from the start.
constexpr std::uint8_t from_start = 254;
// Tiles that a move goes at most, along each axis.
constexpr Index reach = 4;

struct MoveTables {
    Array<const Index> step;
    Array<const double> length, end;
    Array<const Index> first_piece, piece;
    Array<const double> piece_length;
    Array<const Index, 2> axis;
    Array<const double> share;
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
        const float* const own = ground.cost.tiles.data + tile * ground.cost.tiles.shape[2];
        double total = own[moves.axis(k, 0)];
        const double share = moves.share[k];
        if (share != 0.0) total += share * (own[moves.axis(k, 1)] - total);
        if (ground.cost.gradient.shape[0] > 0) {
            const float* const slope = ground.cost.gradient.data + 2 * tile;
            total += ground.cost.of_slope(slope[0], slope[1], moves.direction(k, 0), moves.direction(k, 1));
        }
        return total;
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

BUMPY_RECORD(
    bumpy::MoveTables, step, length, end, first_piece, piece, piece_length, axis, share, direction, near_north,
    near_south)
BUMPY_RECORD(bumpy::Ground, cost, closed, start, goal_row, goal_col, least, bound)

BUMPY_LOOPS(search, search_ways, connect, find_near)
