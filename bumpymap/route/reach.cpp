// Times of the ways to all tiles that are reached. Every tile knows the one before it. A way is followed back to a tile
// whose time is known, and then once more, to set what lies between: each tile is visited twice at most, and nothing
// else has to be held. Ours; see reach.py.
#include "bumpytiles/bindings.hpp"

namespace bumpy {
namespace {

// How the moves of search.py cut tiles; see `MoveTables` there.
struct MovePieces {
    Array<const double> end;
    Array<const Index> first_piece;
    Array<const double> piece_length;
};

// A tile, the move that led to it, and the time of a metre on the tiles.
struct Backwards {
    Array<const std::uint8_t, 2> back;
    Array<const Index, 2> moves;
    MovePieces tables;
    Array<const Index, 2> pieces;
    Array<const float, 2> slow;

    // The time of the move to a tile, the exact integral; row and column become those of the tile before.
    double step(Index& row, Index& col) const {
        const Index k = back(row, col), r = row - moves(k, 0), c = col - moves(k, 1);
        double total = tables.end[k] * (static_cast<double>(slow(r, c)) + static_cast<double>(slow(row, col)));
        for (Index i = tables.first_piece[k]; i < tables.first_piece[k + 1]; ++i)
            total += tables.piece_length[i] * slow(r + pieces(i, 0), c + pieces(i, 1));
        row = r;
        col = c;
        return total;
    }
};

// Fills the time of the way to each tile, that of a metre times tiles; 0 where there is none. `out` comes filled with
// -1, and with the time to the tiles that the start sees.
void add_up_times(
    Array<const std::uint8_t, 2> back, Array<const Index, 2> moves, MovePieces tables, Array<const Index, 2> pieces,
    Array<const float, 2> slow, Array<double, 2> out) {
    const Backwards way{back, moves, tables, pieces, slow};
    for (Index i = 0; i < back.shape[0]; ++i) {
        for (Index j = 0; j < back.shape[1]; ++j) {
            Index row = i, col = j;
            double total = 0.0;
            while (out(row, col) < 0.0) {
                if (back(row, col) >= moves.shape[0]) {
                    out(row, col) = 0.0;
                    break;
                }
                total += way.step(row, col);
            }
            total += out(row, col);
            row = i;
            col = j;
            while (out(row, col) < 0.0) {
                out(row, col) = total;
                total -= way.step(row, col);
            }
        }
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::MovePieces, end, first_piece, piece_length)

BUMPY_LOOPS(reach, add_up_times)
