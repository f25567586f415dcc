// States of pixels by the tiles around: canopy that stands on the ground, gaps, lines.
//
// The states of single tiles come from objects.cpp. A pixel's answer depends on pixels up to 15 away, so with a ring of
// one tile of 15 pixels it is the same wherever a block is cut out. Directions have slopes of 0, 1/2, 1, 2, ...:
// integers alone, so that every machine meets the same pixels. Ours; the rules are those of `settle_solids` in
// features.py.
#include <numbers>

#include "bumpymap/core/pixel_states.hpp"
#include "bumpymap/patches/offsets.hpp"
#include "bumpymap/patches/points_by_tile.hpp"

namespace bumpy {
namespace {

// Farthest pixel that is looked at.
constexpr int most_far = 15;
// Pixels around a mosaic, so that nothing that is looked at lies beyond.
constexpr Index margin = most_far + 1;
// Mark of an obstacle: in the sum of nine marks, the number of obstacles stands in front of that of all parts.
constexpr int full = 17;
// A pixel without points takes the state of one at most so far away, px; rays from the ground to what is overhead; and
// the surroundings of a pixel overhead in which such ground is counted. Together at most 15.
constexpr int fill = 3, ray = 5, near_dense = 5, near_thin = 7;
// In a thin survey, fewer pixels of ground beneath what is overhead may lie beside it.
constexpr double least_thin = 2.0;
// The same of what is low in a dense survey: ground in the corner of two walls may look as if it were beneath.
constexpr int least_low = 4;
// A pixel with obstacles on this number of the eight around it belongs to them.
constexpr int majority = 5;
// In a thin survey, ground must be nearer than an obstacle by this factor of the squared distance to make a pixel
// without points free.
constexpr int nearer = 2;
// Directions of 16 in which something overhead is met from ground beneath it, at least; and from ground in a pixel
// without anything overhead: as many as in the corner of two walls are too few.
constexpr int least_sides = 11, sides_of_yard = 13;
// Points on a pixel, on average, from which on most pixels beneath something hold points of it.
constexpr double held = 1.0;
// Ground is seen beneath enough of what is overhead if this number of its pixels would hold such ground with this share
// of the points of open ground; and never more than that.
constexpr double open = 0.03, open_most = 0.3;
// Points on the surroundings of a pixel overhead, on average, of which one would be ground if it were not hidden.
constexpr double hidden_points = 24.0;
// The same in one half of the surroundings of what is low, a car say, deep beneath it: beside it there may be a gap.
constexpr double hidden_half_dense = 12.0, hidden_half_thin = 6.0;
// Rounds, and pixels in each, in which something that hides the ground goes on through what may hide it.
constexpr int rounds = 3, next = 2;
// Label of what is reached in a round, until that ends.
constexpr std::uint8_t reached = 11;
// Canopy within this number of pixels of what lets no pulse through belongs to it.
constexpr int grow_dense = 1, grow_thin = 3;
// A disc with this number of points on average is empty by chance once in 3,000 times.
constexpr double hole_points = 8.0;
// Most pixels between two parts of a line.
constexpr int gap = 6;
// A part of a line has this number of pixels with points of obstacles beyond the gap, and none this far to its sides.
constexpr int least_part = 2, around_line = 3;
// Most pixels between two parts of a line of which few points were seen, and pixels that its parts may be off the
// direction in which they are looked for.
constexpr int widest_gap = 11, aside_most = 2;
// Points that a gap in such a line would hold, at most, if it were none: chance leaves this number out once in a
// thousand times.
constexpr double between = 7.0;
// Width of the thinnest wall whose gaps are closed so, px: where it would have more points, a wide gap is one.
constexpr double thinnest = 0.5;
// Pixels on either side of the middle of such a gap that are closed: what is known of both ends ends there.
constexpr int closed_middle = 2;
// Points on a pixel, as good as none.
constexpr double least_points = 1e-9;

// Bytes of the pixels of a mosaic, and of a margin around it that begins at row and column -`margin`.
class Map {
  public:
    Map(Index rows, Index cols, std::uint8_t value)
        : wide(cols + 2 * margin), bytes(static_cast<std::size_t>((rows + 2 * margin) * wide), value) {}

    std::uint8_t* row(Index r) { return bytes.data() + (r + margin) * wide + margin; }
    std::uint8_t& operator()(Index r, Index c) { return row(r)[c]; }

    // Bytes from a pixel to another.
    Index way(Offset offset) const { return offset.down * wide + offset.right; }

  private:
    Index wide;
    std::vector<std::uint8_t> bytes;
};

// Eight directions, by the place two pixels on; the other eight lie opposite.
constexpr std::array<Offset, 8> directions{{{0, 2}, {1, 2}, {2, 2}, {2, 1}, {2, 0}, {2, -1}, {2, -2}, {1, -2}}};

// A number of steps of half that length in a direction, rounded to pixels.
constexpr Offset along(Offset two, int step) { return {(step * two.down + 1) >> 1, (step * two.right + 1) >> 1}; }

constexpr Offset opposite(Offset two) { return {-two.down, -two.right}; }

bool is_solid(int state) { return state % SEEN == SOLID || state % SEEN == LOW_SOLID; }

class Settler {
  public:
    Settler(Array<const std::uint8_t, 2> states, Index pixels_of_side, double radius, Array<std::uint8_t, 2> filled)
        : objects(states),
          out(filled),
          rows(states.shape[0]),
          cols(states.shape[1]),
          pixels(pixels_of_side),
          hole(radius),
          marks(rows, cols, 0),
          own(rows, cols, UNSEEN),
          own_if_thin(rows, cols, UNSEEN),
          label(rows, cols, UNSEEN),
          under(rows, cols, 0) {}

    void settle() {
        mark_parts();
        fill_own();
        count_points();
        const bool is_any_overhead = fill_labels();
        if (is_any_overhead) {
            continue_solids();
            for_each_pixel([&](Index r, Index c, double mean) { mark_under(r, c, mean); });
        }
        for_each_pixel([&](Index r, Index c, double mean) {
            const int state = label(r, c), kind = state % SEEN;
            if (state == UNSEEN)
                out(r, c) = UNSEEN;
            else if (!is_overhead(state))
                out(r, c) = static_cast<std::uint8_t>(kind == LONE || kind == STEEP ? FREE : kind);
            else if (stands(r, c, mean))
                out(r, c) = OBSTACLE;
            else
                out(r, c) = objects(r, c) % SEEN == EMPTY ? FREE : CANOPY;
        });
        for_each_pixel([&](Index r, Index c, double mean) {
            const std::uint8_t *mine = marks.row(r) + c, *below = marks.row(r + 1) + c;
            const bool is_inside = mine[1] > 0 && below[-1] > 0 && below[0] > 0 && below[1] > 0;  // no gap begins here
            if (mine[0] > 0 && !is_inside)
                join_from(r, c, std::min(1.0 * widest_gap, between / (thinnest * std::max(mean, least_points))));
        });
    }

  private:
    // Calls function(row, column, points on each pixel of the tile), tile by tile.
    template <class Function>
    void for_each_pixel(Function function) {
        for (std::size_t tile = 0; tile < means.size(); ++tile) {
            const Index top = static_cast<Index>(tile) / (cols / pixels) * pixels;
            const Index left = static_cast<Index>(tile) % (cols / pixels) * pixels;
            for (Index r = top; r < top + pixels; ++r)
                for (Index c = left; c < left + pixels; ++c) function(r, c, means[tile]);
        }
    }

    // Points of each tile on each of its pixels, on average, by how many pixels are empty: as if they lay at random.
    void count_points() {
        means.assign(static_cast<std::size_t>((rows / pixels) * (cols / pixels)), 0.0);
        for (Index r = 0; r < rows / pixels * pixels; ++r)
            for (Index c = 0; c < cols / pixels * pixels; ++c)
                means[static_cast<std::size_t>(r / pixels * (cols / pixels) + c / pixels)] +=
                    objects(r, c) != UNSEEN && objects(r, c) % SEEN != EMPTY;
        for (double& mean : means)
            mean = -std::log(std::max(1.0 - mean / static_cast<double>(pixels * pixels), least_points));
    }

    // Marks pixels that hold a point of an obstacle, were it a single one, with 1, and obstacles with `full`.
    void mark_parts() {
        for (Index r = 0; r < rows; ++r) {
            const Array<const std::uint8_t> states = objects.at(r);
            std::transform(states.begin(), states.end(), marks.row(r), [](int state) {
                const int kind = state % SEEN;
                const bool is_part = (kind == LONE) | (kind == UNDECIDED) | (kind == STEEP);
                return static_cast<std::uint8_t>(is_part + full * (kind == OBSTACLE));
            });
        }
    }

    // Fills the states of pixels with the points around them. In a thin survey a single point of an obstacle is one: a
    // crate of 0.7 m has four points at 8 points/m2. Tests without a branch, which a processor does for many pixels at
    // once.
    void fill_own() {
        std::vector<std::uint8_t> around(static_cast<std::size_t>(cols));
        for (Index r = 0; r < rows; ++r) {
            const std::uint8_t *north = marks.row(r - 1), *middle = marks.row(r), *south = marks.row(r + 1);
            for (std::uint8_t& sum : around) {
                sum = static_cast<std::uint8_t>(
                    north[-1] + north[0] + north[1] + middle[-1] + middle[0] + middle[1] + south[-1] + south[0] +
                    south[1]);
                ++north;
                ++middle;
                ++south;
            }
            const Array<const std::uint8_t> states = objects.at(r);
            std::transform(states.begin(), states.end(), around.begin(), own.row(r), [](std::uint8_t state, int sum) {
                const int kind = state % SEEN;
                const bool joins =
                    (((kind == FREE) | (kind == EMPTY)) & (sum >= majority * full)) | ((kind == STEEP) & (sum > 1));
                return joins ? std::uint8_t{OBSTACLE} : state;
            });
            std::transform(
                states.begin(), states.end(), own.row(r), own_if_thin.row(r), [](int state, std::uint8_t dense) {
                    const int kind = state % SEEN;
                    return kind == LONE || kind == UNDECIDED ? std::uint8_t{OBSTACLE} : dense;
                });
        }
    }

    // State of the nearest of the first pixels around one that has points; an obstacle counts as nearer than it is.
    int nearest_state(const std::uint8_t* at, std::size_t most, int factor) const {
        int found = UNSEEN, square = 0;
        for (std::size_t k = 1; k < most; ++k) {
            const int state = at[ways[k]] % SEEN;
            if (state == EMPTY || state == UNSEEN % SEEN) continue;
            const int far = offsets[k].square();
            if (found != UNSEEN && far > factor * square) break;
            const bool is_near = far <= fill * fill;
            if (state == OBSTACLE && is_near) return OBSTACLE;
            if (found == UNSEEN) square = far;
            if (is_overhead(state) && is_near && far == square)
                found = state;
            else if (found == UNSEEN)
                found = FREE;
        }
        return found;
    }

    // Fills the states of the mosaic, with the nearest where there are no points; returns whether anything is overhead.
    bool fill_labels() {
        for (const Offset& offset : offsets) ways.push_back(label.way(offset));
        bool is_any_overhead = false;
        std::size_t most = 0;
        double mean_before = -1.0;
        for_each_pixel([&](Index r, Index c, double mean) {
            if (mean != mean_before) {
                const double empty_disc = hole_points / (std::numbers::pi * std::max(mean, least_points));
                const double limit = std::min(std::max(hole * hole, empty_disc), 1.0 * most_far * most_far);
                for (most = 0; most < offsets.size() && offsets[most].square() <= limit;) ++most;
                mean_before = mean;
            }
            const std::uint8_t* at = (mean < thin ? own_if_thin : own).row(r) + c;
            int state = *at;
            if (state % SEEN == EMPTY) state = nearest_state(at, most, mean < thin ? nearer : 1);
            label(r, c) = static_cast<std::uint8_t>(state);
            is_any_overhead |= is_overhead(state);
        });
        return is_any_overhead;
    }

    // Labels canopy that may hide the ground as what does, where it continues that.
    void continue_solids() {
        const auto is_solid_near = [&](Index r, Index c) {
            for (Index row = r - next; row <= r + next; ++row)
                for (Index col = c - next; col <= c + next; ++col)
                    if (is_solid(label(row, col))) return true;
            return false;
        };
        for (int round = 0; round < rounds; ++round) {
            for (Index r = 0; r < rows; ++r)
                for (Index c = 0; c < cols; ++c)
                    if (objects(r, c) % SEEN == MAYBE_SOLID && label(r, c) % SEEN == MAYBE_SOLID && is_solid_near(r, c))
                        label(r, c) = reached;
            for (Index r = 0; r < rows; ++r)
                std::replace(label.row(r), label.row(r) + cols, reached, std::uint8_t{LOW_SOLID});
        }
    }

    // True if a ray from a pixel meets something overhead.
    bool meets(const std::uint8_t* at, Offset two) const {
        for (int step = 2; step <= ray; ++step)  // a pixel beside one with ground may be the same object's rim
            if (is_overhead(at[label.way(along(two, step))])) return true;
        return false;
    }

    // True if the ground in a pixel lies beneath what is overhead: it is on all sides, not as beside a wall.
    bool is_under(const std::uint8_t* at, int sides) const {
        int hits = 0;
        for (const Offset two : directions) {
            const bool one = meets(at, two), other = meets(at, opposite(two));
            if (!one && !other) return false;
            hits += one + other;
        }
        return hits >= sides;
    }

    // Marks a pixel with 1 if ground was seen in it, 2 beneath what is overhead, 3 where that would be if any were
    // seen.
    void mark_under(Index r, Index c, double mean) {
        const int state = objects(r, c);
        const bool is_ground = state != UNSEEN && (state >= SEEN || state == FREE);
        const int sides = mean >= held && !is_overhead(state) ? sides_of_yard : least_sides;
        const bool is_beneath = (is_ground || is_overhead(label(r, c))) && is_under(label.row(r) + c, sides);
        under(r, c) = is_beneath ? (is_ground ? 2 : 3) : is_ground;
    }

    // True if what is overhead stands on the ground, of which none is seen around, or beneath a solid object.
    bool stands(Index r, Index c, double mean) {
        const bool is_thin = mean < thin;
        const int near = is_thin ? near_thin : near_dense, grow = is_thin ? grow_thin : grow_dense;
        int overhead = 0, beneath = 0, ground = 0;
        bool any_solid = false, any_low = false;
        for (const Offset& offset : offsets) {
            if (offset.square() > near * near) break;
            const int state = label(r + offset.down, c + offset.right);
            const int mark = under(r + offset.down, c + offset.right);
            overhead += is_overhead(state);
            beneath += mark == 2;
            ground += 0 < mark && mark < 3;
            if (offset.square() <= grow * grow) {
                any_solid |= is_solid(state);
                any_low |= state % SEEN == LOW_SOLID;
            }
        }
        if (ground == 0 && mean * std::numbers::pi * near * near >= hidden_points) return true;
        const double enough = std::min(open_most, 1.0 - std::exp(-open * mean));
        if (any_solid && beneath < std::max(is_thin ? least_thin : 1.0, enough * overhead)) return true;
        if (any_low && mean >= held && beneath < least_low) return true;
        const double half = is_thin ? hidden_half_thin : hidden_half_dense;
        return any_low && hides_half(r, c, near, half / std::max(mean, least_points));
    }

    // True if `least` pixels deep beneath something show no ground in one of 16 halves around a pixel.
    bool hides_half(Index r, Index c, int near, double least) {
        const auto hides = [&](Offset side) {
            int deep = 0;
            for (const Offset& offset : offsets) {
                if (offset.square() > near * near) break;
                if (offset.down * side.down + offset.right * side.right < 0) continue;
                const int mark = under(r + offset.down, c + offset.right);
                if (mark == 2) return false;
                deep += mark > 2;
            }
            return deep >= least;
        };
        return std::ranges::any_of(directions, [&](Offset two) { return hides(two) || hides(opposite(two)); });
    }

    // Pixels with points of a line that ends in a pixel and comes from one direction, 0 if it is none: there is nothing
    // beside a line.
    int points_of_end(const std::uint8_t* at, Offset two) const {
        int count = 0;
        // Across the line, down and right change places.
        const Index far = marks.way({(around_line * two.right) >> 1, -((around_line * two.down) >> 1)});
        const Index near = marks.way({std::abs(two.right) / 2, std::abs(two.down) / 2});
        for (int step = 1; step <= gap; ++step) {
            const std::uint8_t* there = at - marks.way(along(two, step));
            if (there[far] > 0 || there[-far] > 0) return 0;
            count += there[0] > 0 || there[near] > 0 || there[-near] > 0;
        }
        return count >= least_part ? count : 0;
    }

    // Steps to the next pixel with a point of an obstacle, 0 if none is as near as a line may have a gap.
    int next_part(const std::uint8_t* at, Offset two) const {
        for (int step = 1; step <= gap + 1; ++step) {
            if (step * step * two.square() > 4 * (gap + 1) * (gap + 1)) return 0;  // across corners a step is longer
            if (at[marks.way(along(two, step))] > 0) return step;
        }
        return 0;
    }

    // Closes a pixel, where there is one.
    void close(Index r, Index c) {
        if (0 <= r && r < rows && 0 <= c && c < cols && out(r, c) != UNSEEN) out(r, c) = OBSTACLE;
    }

    // Closes the middle of a gap from a pixel to the one `far` from it.
    void close_middle(Index r, Index c, Offset far) {
        const double length = std::sqrt(static_cast<double>(far.square()));
        for (int k = -closed_middle; k <= closed_middle; ++k) {
            const double share = 0.5 + k / length;
            // Rounded down, whatever their sign.
            const auto rounded = [share](int way) { return static_cast<Index>(way * share + 0.5 + margin) - margin; };
            close(r + rounded(far.down), c + rounded(far.right));
        }
    }

    // Closes the middle of a wide gap in a line of few points, of which `count` were seen up to a pixel.
    void join_far(Index r, Index c, Offset two, int count, double widest) {
        const bool is_across_right = std::abs(two.right) < std::abs(two.down);
        constexpr Index beyond = margin - (gap + around_line + 1);  // what a part of a line is looked for in is known
        for (int step = gap + 1; step <= widest_gap; ++step)
            for (int aside = -aside_most; aside <= aside_most; ++aside) {
                Offset far = along(two, step);
                (is_across_right ? far.right : far.down) += aside;
                const Index row = r + far.down, col = c + far.right;
                const double length = std::sqrt(static_cast<double>(far.square()));
                const bool is_known = -beyond <= row && row < rows + beyond && -beyond <= col && col < cols + beyond;
                if (length > widest || !is_known || marks(row, col) == 0) continue;
                const int more = points_of_end(marks.row(row) + col, opposite(two));
                if (more > 0 && (count + more) * length <= between * 2 * gap) close_middle(r, c, far);
                return;
            }
    }

    // Closes the gaps in lines of obstacle points, such as wires of which a few points were seen, that lead east or
    // south from a pixel, at most so wide, px.
    void join_from(Index r, Index c, double widest) {
        const std::uint8_t* at = marks.row(r) + c;
        for (const Offset two : directions) {
            const int width = next_part(at, two);
            if (width == 1) continue;
            const int count = points_of_end(at, two);
            if (count == 0) continue;
            if (width == 0) {
                if (widest > gap) join_far(r, c, two, count, widest);
            } else if (points_of_end(at + marks.way(along(two, width)), opposite(two)) > 0) {
                for (int step = 0; step <= width; ++step) close(r + along(two, step).down, c + along(two, step).right);
            }
        }
    }

    const Array<const std::uint8_t, 2> objects;
    const Array<std::uint8_t, 2> out;
    const Index rows, cols, pixels;
    const double hole;
    const std::vector<Offset> offsets = nearest_offsets(most_far);
    std::vector<Index> ways;  // from a pixel to that of each offset, in a map
    std::vector<double> means;
    Map marks, own, own_if_thin, label, under;
};

// Fills the states of a mosaic; what is left is FREE, OBSTACLE, CANOPY, UNDECIDED, UNSEEN. `hole` is the distance from
// all points beyond which a pixel is unseen, px; more in a tile with few points.
void settle_solids(Array<const std::uint8_t, 2> objects, Index pixels, double hole, Array<std::uint8_t, 2> out) {
    Settler(objects, pixels, hole, out).settle();
}

}  // namespace
}  // namespace bumpy

BUMPY_LOOPS(solids, settle_solids)
