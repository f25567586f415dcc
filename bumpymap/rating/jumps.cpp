// The lines along which the ground of a mosaic of tiles jumps.
//
// A jump is fitted to all points of both sides of eight lines through a pixel, a plane to each side: where few points
// lie on a pixel, runs of pixels tell no step (steps.cpp), and all points of both sides do. It closes where the planes
// differ by more than their errors, and little is left beside them. Ours; see steps.py.
#include <cmath>
#include <limits>
#include <vector>

#include "bumpytiles/bindings.hpp"

namespace bumpy {
namespace {

constexpr double infinite = std::numeric_limits<double>::infinity();
// Pixels of a line before and after its middle.
constexpr int run = 4;
// Lines through a pixel; parts of each of their sides: before the middle, beside it and behind it.
constexpr Index lines_of_pixel = 8, parts_of_side = 3, all_parts = lines_of_pixel * 2 * parts_of_side;
// Known pixels on each side of a jump; and where half of the line is looked at.
constexpr double least_of_side = 6, least_of_half = 8;
// Of a jump, the least difference of the mean levels of both sides: a narrow ditch bends their planes, and has less.
constexpr double same_level = 0.65;
// Most distance of the pixels from the planes of their sides, as a share of the jump (root mean square); and where half
// of the line is looked at.
constexpr double most_rest = 0.25, most_rest_half = 0.15;
// The same from the mean levels of both sides, as a share of their difference.
constexpr double most_spread = 0.5;
// As `most_rest`, of a jump that continues one, and how far from that it may lie, px.
constexpr double most_rest_in_line = 0.4;
constexpr Index in_line = 5;
// Standard errors of the jump beyond what closes; and where half of the line is looked at.
constexpr double errors_beyond = 2.0, errors_beyond_half = 4.0;
// A pixel is on the line of a jump if the levels differ so much of what they do at the pixels across the line.
constexpr double of_neighbours = 0.9;
// Determinants of a plane below that share of their largest value are 0.
constexpr double no_plane = 1e-6;

struct SidePixel {
    Index place;           // in the patch
    double across, along;  // from the pixel to it, across the line and along it, px
};

struct Part {
    double sum, known, squares;  // of heights, of pixels, of squared heights
};

// The plane through the known pixels of one side.
struct Plane {
    bool is_known;
    double at_line;  // its height at the middle of the line, m
    double rest;     // sum of the squared distances from it, m^2
    double error;    // squared standard error of `at_line` over the variance of a pixel
};

// The pixels around one, on both sides of lines through it.
class JumpPatch {
  public:
    const int reach;

    // Pixels up to `width` px beside lines of nine pixels.
    explicit JumpPatch(double width)
        : reach(static_cast<int>(std::ceil(std::hypot(width, run + 0.5)))),
          height((2 * reach + 1) * (2 * reach + 1)),
          is_known(height.size()) {
        constexpr double along[][2] = {{-run - 0.5, -0.5}, {-0.5, 0.5}, {0.5, run + 0.5}};
        for (int line = 0; line < lines_of_pixel; ++line) {
            for (const double sign : {-1.0, 1.0}) {
                for (const auto& [first, last] : along)
                    add_part(line * (M_PI / lines_of_pixel), sign, width, first, last);
            }
        }
    }

    // Fills the heights around a pixel; returns false, and fills nothing, if those of 5 x 5 pixels differ too little.
    bool fill(Array<const double, 2> heights, Index r, Index c, double east, double south, double closing) {
        const auto level = [&](int down, int right) {
            return heights(r + down, c + right) - east * right - south * down;
        };
        double low = infinite, high = -infinite;
        for (int down = -2; down <= 2; ++down) {
            for (int right = -2; right <= 2; ++right) {
                low = std::min(low, level(down, right));  // NaN is neither
                high = std::max(high, level(down, right));
            }
        }
        if (low < infinite && high - low < closing) return false;
        const double base = low < infinite ? low : 0.0;
        Index place = 0;
        for (int down = -reach; down <= reach; ++down) {
            for (int right = -reach; right <= reach; ++right) {
                const double own = level(down, right);
                height[place] = std::isnan(own) ? 0.0 : own - base;
                is_known[place] = std::isnan(own) ? 0.0 : 1.0;
                ++place;
            }
        }
        return true;
    }

    // The difference of the levels of both sides of the pixel, m, at the line on which it is most; 0: none closes. It
    // is negative if a line closes, but not surely.
    //
    // A jump closes if the planes of both sides differ by `closing` and some standard errors more at the line, and so
    // do their levels, and if little is left beside the planes. Halves of the line find it close to the corner of a
    // step.
    double jump(double closing) {
        for (Index k = 0; k < all_parts; ++k) {
            Part part{};
            for (Index i = starts[k]; i < starts[k + 1]; ++i) {
                const double h = height[pixels[i].place];
                part.known += is_known[pixels[i].place];
                part.sum += h;
                part.squares += h * h;
            }
            parts[k] = part;
        }
        double most = 0.0, least = 0.0;
        for (Index line = 0; line < lines_of_pixel; ++line) {
            const double found = jump_along(line, 0, 3, closing);
            most = std::max(most, found);
            least = std::min(least, found);
            most = std::max(most, jump_along(line, 0, 2, closing));
            most = std::max(most, jump_along(line, 1, 3, closing));
        }
        return most > 0.0 ? most : least;
    }

  private:
    // Adds a part of a side of a line: the pixels between two places along it.
    void add_part(double angle, double sign, double width, double first, double last) {
        const double c = std::round(std::cos(angle) * 1e6) / 1e6, s = std::round(std::sin(angle) * 1e6) / 1e6;
        Index place = 0;
        for (int down = -reach; down <= reach; ++down) {
            for (int right = -reach; right <= reach; ++right) {
                const double across = c * right + s * down, along = c * down - s * right;
                if (sign * across > 0.4 && sign * across <= width && along > first && along <= last)
                    pixels.push_back({place, across, along});
                ++place;
            }
        }
        starts.push_back(static_cast<Index>(pixels.size()));
    }

    // The plane through the known pixels of some parts of a side of a line, if they span one.
    Plane plane(Index first, Index last) const {
        double sums[4][4] = {};  // of the products of a pixel's weight, its distances and its height
        for (Index i = starts[first]; i < starts[last]; ++i) {
            const auto& [place, across, along] = pixels[i];
            const double w = is_known[place], row[] = {w, w * across, w * along, height[place]};
            for (int j = 0; j < 4; ++j) {
                for (int k = 0; k < 4; ++k) sums[j][k] += row[j] * row[k];
            }
        }
        const double n = sums[0][0], mu = sums[0][1] / n, mv = sums[0][2] / n, mz = sums[0][3] / n;
        const double uu = sums[1][1] - sums[0][1] * mu, uv = sums[1][2] - sums[0][1] * mv;
        const double vv = sums[2][2] - sums[0][2] * mv, uz = sums[1][3] - sums[0][1] * mz;
        const double vz = sums[2][3] - sums[0][2] * mz, zz = sums[3][3] - sums[0][3] * mz;
        const double det = uu * vv - uv * uv;
        if (det <= no_plane * uu * vv) return {};
        const double across = (uz * vv - vz * uv) / det, along = (vz * uu - uz * uv) / det;
        const double error = 1.0 / n + (mu * mu * vv - 2.0 * mu * mv * uv + mv * mv * uu) / det;
        return {true, mz - across * mu - along * mv, std::max(zz - across * uz - along * vz, 0.0), error};
    }

    // The difference of the levels of both sides of a line, m, if it closes; 0 if not, and less if in doubt. Parts of
    // the sides count from the first up to but not with the last.
    double jump_along(Index line, Index first, Index last, double closing) const {
        const bool is_whole = last - first == parts_of_side;
        const Index one = 2 * parts_of_side * line, other = one + parts_of_side;
        Part before{}, behind{};
        double squares = 0.0;
        for (Index k = first; k < last; ++k) {
            before.sum += parts[one + k].sum;
            before.known += parts[one + k].known;
            behind.sum += parts[other + k].sum;
            behind.known += parts[other + k].known;
            squares += parts[one + k].squares + parts[other + k].squares;
        }
        const double n = before.known, m = behind.known;
        if (std::min(n, m) < (is_whole ? least_of_side : least_of_half)) return 0.0;
        double level = behind.sum / m - before.sum / n;
        const double spread = (squares - before.sum * before.sum / n - behind.sum * behind.sum / m) / (n + m);
        if (std::abs(level) < closing || spread > most_spread * most_spread * level * level) return 0.0;
        const Plane near = plane(one + first, one + last), far = plane(other + first, other + last);
        if (!near.is_known || !far.is_known) return 0.0;
        double jump = far.at_line - near.at_line;
        if (jump < 0.0) {
            level = -level;
            jump = -jump;
        }
        const double rest = (near.rest + far.rest) / (n + m - 6.0), error = std::sqrt(rest * (near.error + far.error));
        const double errors = is_whole ? errors_beyond : errors_beyond_half;
        const double share = is_whole ? most_rest : most_rest_half;
        if (std::min(level, jump) >= closing + errors * error && level > same_level * jump &&
            rest <= share * share * jump * jump)
            return level;
        const bool perhaps =
            is_whole && std::min(level, jump) >= closing && rest <= most_rest_in_line * most_rest_in_line * jump * jump;
        return perhaps ? -level : 0.0;
    }

    std::vector<double> height, is_known;  // less the slope of the tile, m, 0 where unknown; and 1 where known
    std::vector<SidePixel> pixels;         // part by part: of each line both sides, and of each side its parts
    std::vector<Index> starts{0};          // of the parts
    std::array<Part, all_parts> parts;
};

// True if a line that surely closes lies within some pixels.
bool is_sure_near(Array<const double, 2> level, Index r, Index c, Index near) {
    for (Index row = r - near; row <= r + near; ++row) {
        for (Index col = c - near; col <= c + near; ++col) {
            if (level(row, col) > 0.0) return true;
        }
    }
    return false;
}

// Marks the lines along which the ground jumps by `closing` m, where all points of both sides, `width` px wide, are
// taken together.
//
// `heights` and `marks` are (rows, cols) of pixels; the latter come filled with false. Where few points leave it in
// doubt, a line closes that continues one. `east` and `south` are the usual rises of tiles from a pixel to the next
// one, m, `is_wanted` the tiles that are looked at. In the outer ring of tiles only the pixels next to the inner ones
// are marked, and no more looked at than that takes.
void find_jumps(
    Array<const double, 2> heights, Index pixels, Array<const double, 2> east, Array<const double, 2> south,
    Array<const bool, 2> is_wanted, double closing, double width, Array<bool, 2> marks) {
    const Index rows = heights.shape[0], cols = heights.shape[1];
    std::vector<double> memory(rows * cols);
    const Array<double, 2> level{memory.data(), heights.shape};  // difference of the levels of both sides, m
    JumpPatch patch(width);
    const Index near = std::max(std::min(in_line, pixels - 2 - patch.reach), Index{1}), outer = pixels - 1 - near;
    for (Index k = 0; k < is_wanted.count(); ++k) {
        if (!is_wanted.data[k]) continue;
        const Index row = k / is_wanted.shape[1], col = k % is_wanted.shape[1];
        const Index bottom = std::min((row + 1) * pixels, rows - outer);
        const Index right = std::min((col + 1) * pixels, cols - outer);
        for (Index r = std::max(row * pixels, outer); r < bottom; ++r)
            for (Index c = std::max(col * pixels, outer); c < right; ++c)
                if (patch.fill(heights, r, c, east(row, col), south(row, col), closing))
                    level(r, c) = patch.jump(closing);
    }
    for (Index r = pixels - 1; r < rows - pixels + 1; ++r) {
        for (Index c = pixels - 1; c < cols - pixels + 1; ++c) {
            const double own = level(r, c);
            if (own == 0.0) continue;
            bool is_lower = false;
            for (Index down = -1; down <= 1; ++down) {
                for (Index right = -1; right <= 1; ++right)
                    is_lower |= std::abs(own) < of_neighbours * std::abs(level(r + down, c + right));
            }
            marks(r, c) = !is_lower && (own > 0.0 || (own < 0.0 && is_sure_near(level, r, c, near)));
        }
    }
}
}  // namespace
}  // namespace bumpy

BUMPY_LOOPS(jumps, find_jumps)
