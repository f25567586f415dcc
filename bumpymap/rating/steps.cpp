// Steps from west to east in a mosaic of tiles; those from north to south come from the transposed mosaic.
//
// Raw steps and crests come row by row of the mosaic, a whole row at a time, which a processor does for several pixels
// at once. The few that stand out are then looked at one by one, in a patch of the pixels around them: do the single
// points bear the step out? Ours; see steps.py. Where few points lie on a pixel, jumps.cpp looks at all of both sides.
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <span>
#include <utility>
#include <vector>

#include "bumpytiles/bindings.hpp"

namespace bumpy {
namespace {

using Floats = Array<const double>;
using FloatsOut = Array<double>;
using Places = std::vector<std::int32_t>;

constexpr double infinite = std::numeric_limits<double>::infinity();
constexpr double not_known = std::numeric_limits<double>::quiet_NaN();

// Pixels before and after the middle one of a run, and in a run.
constexpr int run = 4, run_length = 2 * run + 1;
// Pixels on each side of a step that are looked at.
constexpr Index reach = 4;
// Shares of a step that must lie between its sides: below the first it does not count, from the second in full.
constexpr double believed = 0.7, certain = 0.85;

struct StepMosaic {
    Array<const double, 2> heights;
    Index pixels;
    double level;
    Array<const double, 2> east, south;
};

// ---- Quantiles ----

// The number at a place when all are sorted; their order is changed.
double smallest(std::span<double> values, Index place) {
    std::nth_element(values.begin(), values.begin() + place, values.end());
    return values[place];
}

// The value with a share of all at or below it; NaN with fewer than `least`. Their order is changed.
double quantile(std::span<double> values, double share, Index least) {
    const auto n = static_cast<Index>(values.size());
    return n >= least ? smallest(values, static_cast<Index>(share * static_cast<double>(n - 1))) : not_known;
}

// Adds a number to others if it is known.
void add_known(std::vector<double>& values, double value) {
    if (!std::isnan(value)) values.push_back(value);
}

// Fills, for each tile, the value with a share of the known ones at or below it; NaN with fewer than `least`. `across`
// is (tiles, tiles, n), `along` the same with rows and columns of tiles exchanged.
void find_quantiles(
    Array<const double, 3> across, Array<const double, 3> along, double share, Index least, Array<double, 2> out) {
    std::vector<double> known;
    for (Index row = 0; row < out.shape[0]; ++row) {
        for (Index col = 0; col < out.shape[1]; ++col) {
            known.clear();
            for (const double value : across.at(row).at(col)) add_known(known, value);
            for (const double value : along.at(col).at(row)) add_known(known, value);
            out(row, col) = quantile(known, share, least);
        }
    }
}

// Fills, for each tile that is asked for, the median difference to the pixel `apart` pixels farther east, m; 0 where
// there is none. `spread` takes the median distance of the differences from it, m; NaN with fewer than `least`.
void find_gradients(
    Array<const double, 2> heights, Index pixels, Index apart, Index least, Array<const bool, 2> is_asked,
    Array<double, 2> middle, Array<double, 2> spread) {
    std::vector<double> differences;
    for (Index row = 0; row < middle.shape[0]; ++row) {
        for (Index col = 0; col < middle.shape[1]; ++col) {
            differences.clear();
            for (Index r = is_asked(row, col) ? row * pixels : (row + 1) * pixels; r < (row + 1) * pixels; ++r) {
                const Floats line = heights.at(r);
                for (Index c = col * pixels; c < (col + 1) * pixels - apart; ++c)
                    add_known(differences, line[c + apart] - line[c]);
            }
            const double usual = differences.empty() ? 0.0 : quantile(differences, 0.5, 1);
            for (double& difference : differences) difference = std::abs(difference - usual);
            middle(row, col) = usual;
            spread(row, col) = quantile(differences, 0.5, least);
        }
    }
}

// ---- Raw steps ----

// Medians of the known ones of nine pixels in a column, for a row of the mosaic.
class Runs {
  public:
    explicit Runs(Index columns) : cols(columns), medians(columns + 2 * reach, not_known) {}

    // Fills the medians of nine rows, each brought to the middle one along the slope.
    const std::vector<double>& of(Array<const double, 2> heights, Floats slope) {
        for (Index c = 0; c < cols; ++c) {
            // Unknown pixels become infinite, up and down in turn, so that the median of nine is that of the known
            // ones.
            double run_of[run_length], turn = 1.0;
#pragma GCC unroll 9
            for (int k = 0; k < run_length; ++k) {
                const double height = heights.data[k * cols + c] - static_cast<double>(k - run) * slope[c];
                const bool unknown = std::isnan(height);
                run_of[k] = unknown ? turn * infinite : height;
                turn = unknown ? -turn : turn;
            }
#pragma GCC unroll 9
            for (int place = 0; place <= run; ++place) {  // the lowest of all nine to the front, then of the rest
#pragma GCC unroll 9
                for (int other = place + 1; other < run_length; ++other) {
                    const double one = run_of[place], two = run_of[other];
                    run_of[place] = std::min(one, two);
                    run_of[other] = std::max(one, two);
                }
            }
            const double pair = 0.5 * (run_of[run - 1] + run_of[run]);  // of an even number; of none it is NaN
            medians[reach + c] = turn > 0.0 ? run_of[run] : pair;
        }
        return medians;
    }

  private:
    Index cols;
    std::vector<double> medians;
};

// The slope on which four heights agree, the nearest first, m per pixel; 0 if they do not.
double bend_of(double a, double b, double c, double d) {
    const double one = b - a, two = c - b, three = d - c;
    const bool rise = (one > 0.0) & (two > 0.0) & (three > 0.0), fall = (one < 0.0) & (two < 0.0) & (three < 0.0);
    const double size = std::min(std::min(std::abs(one), std::abs(two)), std::abs(three));
    return rise ? size : (fall ? -size : 0.0);
}

// The mean of two heights; the known one, if one is.
double mean(double near, double far) {
    const double height = std::isnan(far) ? near : 0.5 * (near + far);
    return std::isnan(near) ? far : height;
}

// The least of the known ones of four heights; infinite if none is.
double lowest(double a, double b, double c, double d) {
    return std::min(std::min(std::min(std::min(infinite, a), b), c), d);
}

// How far to believe a step of which so much is sure, 0 to 1.
double share_of(double surely, double step) {
    const double share = step > 0.0 ? (surely - believed * step) / ((certain - believed) * step) : 1.0;
    return std::min(std::max(share, 0.0), 1.0);
}

// One side of a step, continued to the middle of its pixel.
struct Side {
    double bend, level, low, high;
    double unknown;  // pixels that come before the first known one, 2 at most
};

// From four runs, the nearest first, that lie on a slope away from the pixel. `third` and `fourth` are 0 if this many
// pixels of a side must be above, or below, those of the other side, else infinite.
inline Side side_of(double a, double b, double c, double d, double slope, double third, double fourth) {
    a -= slope;
    b -= 2.0 * slope;
    c -= 3.0 * slope;
    d -= 4.0 * slope;
    const double bend = bend_of(a, b, c, d);
    a -= bend;
    b -= 2.0 * bend;
    c -= 3.0 * bend;
    d -= 4.0 * bend;
    const double low = lowest(a, b, c + third, d + fourth), high = -lowest(-a, -b, third - c, fourth - d);
    const double unknown = std::isnan(a) ? (std::isnan(b) ? 2.0 : 1.0) : 0.0;
    return {bend, mean(a, b), low, high, unknown};
}

// Fills the steps of a row: in the middle of pixels, and the least ones anywhere in them.
void compare_sides(const double* runs, Floats slope, double third, double fourth, double* middle, FloatsOut least) {
    for (Index c = 0; c < least.size(); ++c) {
        const double* const at = runs + reach + c;
        const Side right = side_of(at[1], at[2], at[3], at[4], slope[c], third, fourth);
        const Side left = side_of(at[-1], at[-2], at[-3], at[-4], -slope[c], third, fourth);
        middle[c] = std::abs(right.level - left.level);
        // Over unknown pixels, a rise may be a slope.
        const double part = 2.0 / (2.0 + right.unknown + left.unknown);
        const double surely = std::max(right.low - left.high, left.low - right.high) * part;
        const double usual = 0.5 * std::abs(right.low + right.high - left.low - left.high) * part;
        // The slope on the left is counted away from the pixel, too.
        const double reduced = surely * share_of(surely, usual) - 0.5 * std::abs(right.bend + left.bend);
        least[c] = surely == infinite ? not_known : std::max(reduced, 0.0);
    }
}

// Fills how far the pixels of a row lie above the runs three and four pixels on both sides of them.
void find_crests(Floats heights, const double* runs, Floats slope, FloatsOut crest) {
    for (Index c = 0; c < crest.size(); ++c) {
        const double* const at = runs + reach + c;
        const double right = mean(at[3], at[4]) - 3.5 * slope[c], left = mean(at[-3], at[-4]) + 3.5 * slope[c];
        crest[c] = heights[c] - std::max(std::max(-infinite, left), right);
    }
}

// Fills the steps from west to east at every pixel; `side` pixels, 2 to 4, are one side of a step.
//
// `least` (rows, cols): the least step anywhere in the pixel, m; NaN where a side is unknown. `crest`: height of a
// pixel above the runs three and four pixels on both sides of it, m; NaN if it is unknown, infinite if both sides are.
// `inside` (tiles, tiles, (pixels - 8)^2): steps in the middle of pixels whose support lies in the tile, m.
void find_raw_steps(
    StepMosaic mosaic, Index side, Array<double, 2> least, Array<double, 2> crest, Array<double, 3> inside) {
    const Index pixels = mosaic.pixels, width = pixels - 2 * reach, cols = mosaic.east.shape[1];
    const double third = side >= 3 ? 0.0 : infinite, fourth = side >= 4 ? 0.0 : infinite;
    Runs runs(cols);
    std::vector<double> middle(cols);
    for (Index r = 0; r < least.shape[0]; ++r) {
        const Index row = r / pixels, line = r % pixels;
        const Floats east = mosaic.east.at(row);
        const double* medians = runs.of(mosaic.heights.slice(r, r + run_length), mosaic.south.at(row)).data();
        compare_sides(medians, east, third, fourth, middle.data(), least.at(r));
        find_crests(mosaic.heights.at(r + run), medians, east, crest.at(r));
        if (line < run || line >= pixels - run) continue;
        for (Index col = 0; col < inside.shape[1]; ++col)
            std::copy_n(middle.data() + col * pixels + reach, width, &inside(row, col, (line - run) * width));
    }
}

// ---- Steps and ridges that stand out ----

// Pixels from a step to what counts as its sides.
constexpr Index side_distance = 2;
// Steps below this do not count where the noise of both sides is unknown, m.
constexpr double unknown_noise = 0.15;
// A step counts in full from so much above the limit on, as a share of it.
constexpr double ramp = 0.4;
// Standard errors of a median between it and the height that counts as that of a side.
constexpr double standard_errors = 3.0;
// Share of the points of a side, and of a ridge, that may lie beyond the height that counts.
constexpr double astray = 0.2, astray_on_ridge = 0.25;
// Pixels from the middle of a wall to those beside it.
constexpr double beside_wall = 0.9;
// From the line of a ridge to the ground beside it, in widths of a level; and at least, px.
constexpr double foot_distance = 0.38, least_foot_distance = 0.75;
// Known pixels on each side of a step, and on the line of a ridge.
constexpr Index least_points = 5, least_on_ridge = 2;
// Pixels along the edges where the rating underestimates a wall: 0.4 m of 3 m.
constexpr Index rim = 2;
// A line moves up to this number of quarters of a pixel to either side with every row.
constexpr int most_turn = 4;

// Places, in the patch around a pixel, of those on a line through it and on both sides of that.
struct Line {
    Places ridge, left_of_ridge, right_of_ridge, left, right;
};

using Values = std::span<double>;

// The pixels around one, whose step or ridge is looked at.
struct Patch {
    int width;
    std::vector<double> heights;                // row by row, each brought to the pixel along the slope of its tile
    std::array<Line, 2 * most_turn + 1> lines;  // by their turn
    std::array<std::vector<double>, 3> values;  // known heights of a line and of its sides

    // For levels of a width, px.
    explicit Patch(double level)
        : width(2 * static_cast<int>(std::floor(level * std::sqrt(2.0) + run)) + 1), heights(run_length * width) {
        for (int turn = -most_turn; turn <= most_turn; ++turn) fill_line(turn, level);
        for (auto& known : values) known.resize(heights.size());
    }

    const Line& line(int turn) const { return lines[turn + most_turn]; }

    void fill_line(int turn, double level) {
        Line& line = lines[turn + most_turn];
        const double shear = turn / double{most_turn};
        const double wide = level * std::sqrt(1.0 + shear * shear);
        const double foot = std::max(foot_distance * wide, least_foot_distance);
        for (int down = -run; down <= run; ++down) {
            const int quarters = turn * down, place = (run + down) * width + width / 2;
            const double middle = shear * down;
            const auto add = [place](Places& places, double first, double last) {
                for (int right = static_cast<int>(std::ceil(first)); right <= last; ++right)
                    places.push_back(place + right);
            };
            add(line.ridge, (quarters + 1) >> 2, (quarters + 2) >> 2);  // rounded down
            add(line.left_of_ridge, middle - wide, middle - foot);
            add(line.right_of_ridge, middle + foot, middle + wide);
            add(line.left, middle - wide, middle - beside_wall);
            add(line.right, middle + beside_wall, middle + wide);
        }
    }

    void fill(const StepMosaic& mosaic, Index r, Index c) {
        const double east = mosaic.east(r / mosaic.pixels, c), south = mosaic.south(r / mosaic.pixels, c);
        const int half = width / 2, first = static_cast<int>(std::max(-c, Index{-half}));
        const int last = static_cast<int>(std::min(mosaic.heights.shape[1] - 1 - c, Index{half}));
        if (last - first < 2 * half) std::fill(heights.begin(), heights.end(), not_known);
        for (int down = -run; down <= run; ++down) {
            const double* const from = &mosaic.heights(r + run + down, c);
            double* const out = heights.data() + (down + run) * width + half;
            for (int k = first; k <= last; ++k) out[k] = from[k] - east * k - south * down;
        }
    }

    // The known heights of some places, in one of the lists of values.
    Values known(const Places& places, Index list) {
        double* const out = values[list].data();
        Index n = 0;
        for (const std::int32_t place : places) {
            out[n] = heights[place];
            n += !std::isnan(out[n]);
        }
        return {out, static_cast<std::size_t>(n)};
    }
};

// The place of the height that counts as that of a side, among `n` in order: see `gap`.
Index rank(Index n) {
    const auto number = static_cast<double>(n);
    const double place = std::min(0.5 * (number - standard_errors * std::sqrt(number)), astray * number);
    return std::max(Index{0}, static_cast<Index>(std::floor(place)));
}

// The height between the points of both sides of a pixel, as it surely is at least, m.
//
// A side is a parallelogram of 9 rows, as wide as a level, along a wall that moves `turn` / 4 pixels to the east with
// every row. Of its known pixels in order of height, that one counts which is three standard errors of the median from
// the middle, or has a fifth of them beyond it, whichever is farther out.
double gap(int turn, Patch& patch) {
    Values low = patch.known(patch.line(turn).left, 0), high = patch.known(patch.line(turn).right, 1);
    if (std::min(std::ssize(low), std::ssize(high)) < least_points) return -infinite;
    const auto n = static_cast<double>(low.size()), m = static_cast<double>(high.size());
    const double lower = std::accumulate(low.begin(), low.end(), 0.0);
    const double upper = std::accumulate(high.begin(), high.end(), 0.0);
    if (upper * n < lower * m) std::swap(low, high);
    return smallest(high, rank(std::ssize(high))) - smallest(low, std::ssize(low) - 1 - rank(std::ssize(low)));
}

// The share of a step that the points on both of its sides bear out, 0 to 1, at the angle that suits them best.
double share_borne_out(double step, Patch& patch) {
    double best = 0.0;
    for (const int turn : {0, 2, -2, 4, -4}) {
        best = std::max(best, share_of(gap(turn, patch), step));
        if (best >= 1.0) return 1.0;
    }
    return best;
}

// The height of a ridge along a line through a pixel, m; 0 where the points do not bear it out.
//
// It is the median of the pixels on the line, in 9 rows, above that of the higher side. The line moves `turn` / 4
// pixels to the east with every row. Sides are as in `gap`, less what is next to the line.
//
// Returns 0 early where the ridge is surely no higher than `least`: soonest with a `guess` just above a quarter of the
// line. Neither changes the height of a higher one.
double ridge_along(int turn, double guess, double least, Patch& patch) {
    const Line& line = patch.line(turn);
    const Values top = patch.known(line.ridge, 0);
    if (std::ssize(top) < least_on_ridge) return 0.0;
    const auto place = static_cast<Index>(astray_on_ridge * static_cast<double>(top.size()));
    const auto is_low = [guess](double height) { return height <= guess; };
    const double height = std::count_if(top.begin(), top.end(), is_low) > place ? guess : smallest(top, place);
    const auto is_buried = [&](const Places& side) {  // the line is surely not that far above what counts as a side
        const auto is_near = [&](std::int32_t at) { return height - patch.heights[at] <= believed * least; };
        return std::count_if(side.begin(), side.end(), is_near) > rank(std::ssize(side));
    };
    if (is_buried(line.left_of_ridge) || is_buried(line.right_of_ridge)) return 0.0;
    const Values left = patch.known(line.left_of_ridge, 1), right = patch.known(line.right_of_ridge, 2);
    if (std::min(std::ssize(left), std::ssize(right)) < least_points) return 0.0;
    const Index last = std::ssize(left) - 1, other_last = std::ssize(right) - 1;
    const double high =
        std::max(smallest(left, last - rank(std::ssize(left))), smallest(right, other_last - rank(std::ssize(right))));
    const double surely = smallest(top, place) - high;
    const double foot = std::max(smallest(left, last / 2), smallest(right, other_last / 2));
    const double step = std::max(smallest(top, std::ssize(top) / 2) - foot, 0.0);
    return step * share_of(surely, step);
}

// The height of the ridge through a pixel at the angle that suits it best, m; 0 if none is higher than `least`.
double highest_ridge(double ground, double least, Patch& patch) {
    double ridge = least;
    for (int turn = -most_turn; turn <= most_turn; ++turn)
        ridge = std::max(ridge, ridge_along(turn, ground + believed * ridge, ridge, patch));
    return ridge > least ? ridge : 0.0;
}

// The share of a step that counts, 0 to 1: none up to the limit, all from 1.4 times that.
double stands_out(double step, double limit) {
    const double share = limit > 0.0 ? (step / limit - 1.0) / ramp : 1.0;
    return std::min(std::max(share, 0.0), 1.0);
}

// Keeps the steps of a row that are the highest of three and stand out from noise; 0 elsewhere.
void keep_peaks(Floats least, const std::vector<double>& limits, std::vector<double>& felt) {
    const Index last = least.size() - 1;
    for (Index c = 0; c <= last; ++c) {
        const double before = c > 0 ? least[c - 1] : -1.0, behind = c < last ? least[c + 1] : -1.0;
        const bool is_lower = (least[c] < before) | (least[c] < behind);
        felt[c] = is_lower ? 0.0 : least[c] * stands_out(least[c], limits[c]);
    }
}

// The root mean square of the limits of both sides of a pixel, m; that of the known one, if one is.
double limit_of_sides(double before, double behind) {
    const int known = std::isfinite(before) + std::isfinite(behind);
    const double first = std::isnan(before) ? 0.0 : before * before;
    const double second = std::isnan(behind) ? 0.0 : behind * behind;
    return known > 0 ? std::sqrt((first + second) / known) : unknown_noise;
}

// Fills the limits of a row of pixels from those of its tiles.
void fill_limits(Floats of_tiles, Index pixels, std::vector<double>& limits) {
    const Index cols = std::ssize(limits);
    for (Index c = 0; c < cols; ++c) {
        const double before = c >= side_distance ? of_tiles[(c - side_distance) / pixels] : not_known;
        const double behind = c + side_distance < cols ? of_tiles[(c + side_distance) / pixels] : not_known;
        limits[c] = limit_of_sides(before, behind);
    }
}

// To which part of a tile a column of its pixels belongs, as in the last axis of what `find_peaks` fills.
Index part_of_tile(Index k, Index pixels) {
    if (k == 0) return 0;
    if (k == pixels - 1) return 1;
    return k < rim || k >= pixels - rim ? 2 : 3;
}

struct Peak {
    double step;       // or ridge, m; NaN if it is unknown, less than what was asked for where it is surely lower
    double borne_out;  // the same, in full where its points bear out any part of it
};

// The step or ridge at a pixel with a raw step that stands out, a crest and a limit, m.
Peak peak_at(
    const StepMosaic& mosaic, Index r, Index c, double felt, double crest, double limit, double least, Patch& patch) {
    double borne_out = 0.0;
    const bool is_step = felt > std::max(least, 0.0), is_crest = crest > limit;
    if (is_step || is_crest) patch.fill(mosaic, r, c);
    if (is_step) {
        const double share = share_borne_out(felt, patch);
        borne_out = share > 0.0 ? felt : 0.0;
        felt *= share;
    }
    if (is_crest) {
        const double ground = mosaic.heights(r + run, c) - crest;
        const double ridge = highest_ridge(ground, std::max(std::max(limit, felt), least), patch);
        felt = std::max(felt, ridge * stands_out(ridge, limit));
    }
    return {felt, std::max(felt, borne_out)};
}

// Fills the highest step of tiles, or ridge if that is higher, m; negative where none is known. A step counts where it
// is the highest of three in its row and stands out.
//
// `highest` is (tiles, tiles, 4): in the pixels of the western border, of the eastern one, in two pixels along both of
// them, and in all. In the outer ring of tiles only the borders to the inner ones are filled. `limit` is
// (tiles, tiles): steps of that height do not count, m. That of a pixel is between those of the tiles two pixels before
// and behind it. `closed` is (rows, cols), filled with 0: the same pixels are 2 where the step is `closing` m high, and
// 1 where it is if the points bear out any part of it.
void find_peaks(
    StepMosaic mosaic, Array<const double, 2> least, Array<const double, 2> crest, Array<const double, 2> limit,
    double closing, Array<double, 3> highest, Array<std::uint8_t, 2> closed) {
    const Index cols = least.shape[1], pixels = mosaic.pixels, last = limit.shape[1] - 1;
    std::vector<double> limits(cols), felt(cols);
    std::vector<Index> tile(cols), part_of(cols);
    for (Index c = 0; c < cols; ++c) {
        tile[c] = c / pixels;
        part_of[c] = part_of_tile(c % pixels, pixels);
    }
    Patch patch(mosaic.level);
    for (Index r = pixels; r < (limit.shape[0] - 1) * pixels; ++r) {
        const Index row = r / pixels;
        if (r % pixels == 0) {
            fill_limits(limit.at(row), pixels, limits);
            std::fill_n(&highest(row, 0, 0), 4 * (last + 1), -1.0);
            // Nothing is higher than what nobody asks for.
            for (const Index part : {0, 2, 3}) highest(row, 0, part) = infinite;
            for (const Index part : {1, 2, 3}) highest(row, last, part) = infinite;
        }
        keep_peaks(least.at(r), limits, felt);
        for (Index c = 0; c < cols; ++c) {
            const Index part = part_of[c];
            const FloatsOut found = highest.at(row).at(tile[c]);
            if (found[part] == infinite) continue;
            const double asked = std::min(found[part], closing);
            if (!(felt[c] > asked || crest(r, c) > limits[c])) continue;
            const auto [step, borne_out] = peak_at(mosaic, r, c, felt[c], crest(r, c), limits[c], asked, patch);
            closed(r, c) = static_cast<std::uint8_t>((borne_out >= closing) + (step >= closing));
            for (Index k = part; k < 4; ++k) {
                if ((k == part || k > 1) && step > found[k]) found[k] = step;
            }
        }
    }
}

// ---- Pixels that close ----

// Pixels to each side in which another one makes a line of one with a step.
constexpr Index beside = 2;

// Marks the pixels that lie so far below one beside them; `least` is (tiles, tiles), m.
void find_low(Array<const float, 2> heights, Index pixels, Array<const double, 2> least, Array<bool, 2> low) {
    constexpr float lowest = -std::numeric_limits<float>::infinity();
    const Index rows = heights.shape[0], cols = heights.shape[1];
    std::vector<float> highest(cols + 2, lowest);  // of three rows, and no height beyond them
    for (Index r = 0; r < rows; ++r) {
        std::fill(highest.begin(), highest.end(), lowest);
        for (Index row = std::max(r - 1, Index{0}); row <= std::min(r + 1, rows - 1); ++row) {
            const Array<const float> line = heights.at(row);
            for (Index c = 0; c < cols; ++c) highest[c + 1] = line[c] > highest[c + 1] ? line[c] : highest[c + 1];
        }
        for (Index col = 0; col < least.shape[1]; ++col) {
            const double limit = least(r / pixels, col);
            for (Index c = col * pixels; c < (col + 1) * pixels; ++c) {
                const float top = std::max(std::max(highest[c], highest[c + 1]), highest[c + 2]);
                low(r, c) = static_cast<double>(top - heights(r, c)) >= limit;
            }
        }
    }
}

// Decides which pixels close: those of jumps, and of steps that `find_peaks` marked, `along` with rows and columns
// exchanged. In thin tiles a step must be sure, and one more pixel near it closed or low: a single one is no line.
void close_steps(
    Array<const std::uint8_t, 2> across, Array<const std::uint8_t, 2> along, Index pixels, Array<const bool, 2> is_thin,
    Array<const bool, 2> jumps, Array<const bool, 2> low, Array<bool, 2> closed) {
    const Index rows = closed.shape[0], cols = closed.shape[1];
    std::vector<std::uint8_t> memory(rows * cols);
    const Array<std::uint8_t, 2> found{memory.data(), closed.shape};  // closed or low
    std::vector<std::array<Index, 2>> doubtful;
    for (Index r = 0; r < rows; ++r) {
        for (Index c = 0; c < cols; ++c) {
            const bool thin = is_thin(r / pixels, c / pixels);
            const bool is_step = std::max(across(r, c), along(c, r)) >= (thin ? 2 : 1);
            if (is_step && thin) doubtful.push_back({r, c});
            closed(r, c) = is_step || jumps(r, c);
            found(r, c) = closed(r, c) || low(r, c);
        }
    }
    for (const auto [r, c] : doubtful) {
        int number = 0;
        for (Index row = std::max(r - beside, Index{0}); row <= std::min(r + beside, rows - 1); ++row)
            for (Index col = std::max(c - beside, Index{0}); col <= std::min(c + beside, cols - 1); ++col)
                number += found(row, col);
        closed(r, c) = number > 1 || jumps(r, c);
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::StepMosaic, heights, pixels, level, east, south)

BUMPY_LOOPS(steps, find_quantiles, find_gradients, find_raw_steps, find_peaks, find_low, close_steps)
