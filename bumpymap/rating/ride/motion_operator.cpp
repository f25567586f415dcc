// A vehicle's wheels on the ground of patches, and what its chassis does there: the sparse matrices of operator.py.
//
// Sixteen patches ride side by side: their heights lie together (*lanes*), so a processor computes several of them at
// once, and only where nothing depends on their order. The sums over one patch keep their order, and so their bits: the
// same patch rides alike wherever it is among others. Ours; see operator.py for the model.
#include <algorithm>
#include <cmath>
#include <vector>

#include "bumpytiles/bindings.hpp"
#include "bumpytiles/grouping.hpp"
#include "lanes.hpp"

namespace bumpy {
namespace {

constexpr int group = 16;  // patches side by side
using Heights = Lanes<Floats8, group>;
using Numbers = std::array<double, group>;

// Below all ground, m.
constexpr float lowest = -3e38F;

struct WheelShape {
    Array<const std::int32_t> starts, row, col;
    Array<const float> rise;
};

struct PitchSamples {
    Array<const std::int32_t> starts, node;
    Array<const float> weight;
    Array<const Index> bounds;
};

// Rows over the envelopes of a vehicle's wheels, which both of its operators have.
struct WheelRows {
    Index fine;
    WheelShape wheel;
    PitchSamples samples;
};

struct Poses {
    Array<const std::int32_t, 3> wheel_node, belly_node;
    Array<const float, 3> wheel_weight, belly_weight;
    double wheelbase, belly_half, clearance;
};

// ---- Wheels on the ground of a group ----

// The lowest and the farther of the two pixels between which a node lies, and how far it is from the first.
struct Between {
    Index pixel;
    float share;

    Between(Index node, Index fine, Index pixels) {
        const double place = static_cast<double>(node) / static_cast<double>(fine) - 0.5;
        pixel = std::min(std::max(static_cast<Index>(std::floor(place)), Index{0}), pixels - 2);
        share = static_cast<float>(std::min(std::max(place - static_cast<double>(pixel), 0.0), 1.0));
    }
};

// Groups of patches, one after the other, with the wheels of a vehicle rolled over them.
class Groups {
  public:
    std::vector<Index> members;     // patches of the group
    std::vector<Heights> bare;      // heights at the nodes, m
    std::vector<Heights> envelope;  // of the lowest point of a wheel in each direction, at each node, m

    Groups(Array<const bool> is_known, Array<const float, 3> given, Index nodes_of_pixel, const WheelShape& shape)
        : known(is_known),
          patches(given),
          wheel(shape),
          fine(nodes_of_pixel),
          pixels(given.shape[1]),
          nodes(pixels * fine + 1),
          relief(pixels * pixels) {
        for (Index o = 0; o < wheel.row.size(); ++o)
            margin = std::max({margin, Index{std::abs(wheel.row[o])}, Index{std::abs(wheel.col[o])}});
        side = nodes + 2 * margin;
        wide.resize(side * side);
        bare.resize(nodes * nodes);
        envelope.resize((wheel.starts.size() - 1) * nodes * nodes);
    }

    // Takes the next known patches, a group at most, and rolls the wheels over them; returns false if there are none.
    bool next() {
        members.clear();
        for (; following < known.size() && members.size() < group; ++following) {
            if (!known[following]) continue;
            const Array<const float, 2> heights = patches.at(following);
            for (Index k = 0; k < heights.count(); ++k) relief[k].set(std::ssize(members), heights.data[k]);
            members.push_back(following);
        }
        if (members.empty()) return false;
        lay_nodes();
        mirror_margin();
        roll_wheel();
        return true;
    }

  private:
    // Bilinear heights at the nodes.
    void lay_nodes() {
        for (Index row = 0; row < nodes; ++row) {
            const Between down(row, fine, pixels);
            for (Index col = 0; col < nodes; ++col) {
                const Between right(col, fine, pixels);
                const Heights* const north = &relief[down.pixel * pixels + right.pixel];
                const Heights* const south = north + pixels;
                const Heights a = north[0] + (north[1] - north[0]) * right.share;
                const Heights b = south[0] + (south[1] - south[0]) * right.share;
                bare[row * nodes + col] = a + (b - a) * down.share;
            }
        }
    }

    // Puts a mirrored margin around the nodes.
    void mirror_margin() {
        const auto mirrored = [this](Index place) {
            const Index period = 2 * (nodes - 1), node = modulo(place - margin, period);
            return std::min(node, period - node);
        };
        for (Index r = 0; r < side; ++r) {
            for (Index c = 0; c < side; ++c) wide[r * side + c] = bare[mirrored(r) * nodes + mirrored(c)];
        }
    }

    // The height of the lowest point of a wheel that touches the ground.
    void roll_wheel() {
        Heights* out = envelope.data();
        for (Index turn = 0; turn + 1 < wheel.starts.size(); ++turn) {
            for (Index r = 0; r < nodes; ++r) {
                for (Index c = 0; c < nodes; ++c) {
                    Heights highest = lowest;
                    for (Index o = wheel.starts[turn]; o < wheel.starts[turn + 1]; ++o) {
                        const Heights& ground = wide[(r + margin + wheel.row[o]) * side + c + margin + wheel.col[o]];
                        highest.raise(ground + wheel.rise[o]);
                    }
                    *out++ = highest;
                }
            }
        }
    }

    Array<const bool> known;
    Array<const float, 3> patches;
    WheelShape wheel;
    Index fine, pixels, nodes, margin = 0, side = 0, following = 0;
    std::vector<Heights> relief, wide;  // heights of the pixels, and at the nodes with a mirrored margin, m
};

// ---- What a chassis does ----

struct Means {
    Numbers size, square;  // mean absolute value and root mean square
};

// Of a group of samples.
Means sample_means(const PitchSamples& samples, Index k, const std::vector<Heights>& envelope) {
    Means means{};
    const Index first = samples.bounds[k], last = samples.bounds[k + 1];
    for (Index s = first; s < last; ++s) {
        Heights total{};
        for (Index entry = samples.starts[s]; entry < samples.starts[s + 1]; ++entry)
            total += samples.weight[entry] * envelope[samples.node[entry]];
        for (int lane = 0; lane < group; ++lane) {
            const double value = total[lane];
            means.size[lane] += std::abs(value);
            means.square[lane] += value * value;
        }
    }
    const auto number = static_cast<double>(last - first);
    for (int lane = 0; lane < group; ++lane) {
        means.size[lane] /= number;
        means.square[lane] = std::sqrt(means.square[lane] / number);
    }
    return means;
}

// Root mean squares of pitch and twist, rad; and how far the ground reaches to the belly.
std::array<Numbers, 3> pose_numbers(const Poses& vehicle, const Groups& groups) {
    const auto read = [](const std::vector<Heights>& heights, const std::int32_t* node, const float* weight, int lane) {
        double total = 0.0;
        for (int corner = 0; corner < 4; ++corner) total += weight[corner] * heights[node[corner]][lane];
        return total;
    };
    std::array<Numbers, 3> found{};
    auto& [pitches, twists, strike] = found;
    const Index number = vehicle.wheel_node.shape[0];
    for (Index p = 0; p < number; ++p) {
        for (int lane = 0; lane < group; ++lane) {
            const auto wheel = [&](Index k) {
                return read(groups.envelope, &vehicle.wheel_node(p, k, 0), &vehicle.wheel_weight(p, k, 0), lane);
            };
            const double fl = wheel(0), fr = wheel(1), rl = wheel(2), rr = wheel(3);
            const double pitch = (fl + fr - rl - rr) / (2.0 * vehicle.wheelbase);
            const double twist = (fl - fr - rl + rr) / (2.0 * vehicle.wheelbase);
            pitches[lane] += pitch * pitch;
            twists[lane] += twist * twist;
            const double level = (fl + fr + rl + rr) / 4.0;
            for (int k = 0; k < 3; ++k) {
                const double ground =
                    read(groups.bare, &vehicle.belly_node(p, k, 0), &vehicle.belly_weight(p, k, 0), lane);
                const double above = ground - level - (1 - k) * vehicle.belly_half * pitch;
                strike[lane] = std::max(strike[lane], above / vehicle.clearance);
            }
        }
    }
    for (Numbers* squares : {&pitches, &twists}) {
        for (double& square : *squares) square = std::sqrt(square / static_cast<double>(number));
    }
    return found;
}

// Rolls a vehicle over patches, plane-removed relief without holes, m; others than the known ones keep what is stored.
//
// Fills mean absolute value and root mean square of each group of samples in `motions` (tiles, groups, 2); `look` sees
// each group of patches.
template <class Look>
void roll(
    Array<const bool> known, Array<const float, 3> relief, const WheelRows& vehicle, Array<double, 3> motions,
    Look look) {
    Groups groups(known, relief, vehicle.fine, vehicle.wheel);
    while (groups.next()) {
        for (Index k = 0; k < motions.shape[1]; ++k) {
            const Means means = sample_means(vehicle.samples, k, groups.envelope);
            for (Index lane = 0; lane < std::ssize(groups.members); ++lane) {
                motions(groups.members[lane], k, 0) = means.size[lane];
                motions(groups.members[lane], k, 1) = means.square[lane];
            }
        }
        look(groups);
    }
}

void move_over_patches(
    Array<const bool> known, Array<const float, 3> relief, WheelRows vehicle, Array<double, 3> motions) {
    roll(known, relief, vehicle, motions, [](const Groups&) {});
}

// Fills `stands` (tiles, 3) too, see `pose_numbers`.
void ride_patches(
    Array<const bool> known, Array<const float, 3> relief, WheelRows vehicle, Poses poses, Array<double, 3> motions,
    Array<double, 2> stands) {
    roll(known, relief, vehicle, motions, [&](const Groups& groups) {
        const std::array<Numbers, 3> found = pose_numbers(poses, groups);
        for (Index lane = 0; lane < std::ssize(groups.members); ++lane) {
            for (Index k = 0; k < 3; ++k) stands(groups.members[lane], k) = found[k][lane];
        }
    });
}

// ---- Wheels along a line ----

// The bilinear height between the centres of pixels at a node, `fine` of which lie along a pixel, m.
double node_height(Array<const double, 2> heights, Index fine, Index i, Index j) {
    const double row = static_cast<double>(i) / static_cast<double>(fine) - 0.5;
    const double col = static_cast<double>(j) / static_cast<double>(fine) - 0.5;
    const auto top = static_cast<Index>(std::floor(row)), left = static_cast<Index>(std::floor(col));
    const double south = row - static_cast<double>(top), east = col - static_cast<double>(left);
    const double a = heights(top, left), b = heights(top, left + 1);
    const double west_side = a + (heights(top + 1, left) - a) * south;
    const double east_side = b + (heights(top + 1, left + 1) - b) * south;
    return west_side + (east_side - west_side) * east;
}

// The lowest point of a wheel, in one of its directions, at a node, m; NaN if it meets ground that is not known.
double wheel_height(Array<const double, 2> heights, Index fine, const WheelShape& wheel, Index turn, Index i, Index j) {
    double highest = -HUGE_VAL;
    for (Index o = wheel.starts[turn]; o < wheel.starts[turn + 1]; ++o) {
        const double lift = node_height(heights, fine, i + wheel.row[o], j + wheel.col[o]) + wheel.rise[o];
        if (std::isnan(lift)) return lift;
        highest = std::max(highest, lift);
    }
    return highest;
}

// Fills the lowest point of wheels at n places, m; NaN where one meets ground that is not known.
//
// `heights` (rows, cols): m; `place` (n, 2): row and column, pixels, a wheel and two pixels or more from all edges;
// `turn` (n,): the direction of `wheel`. `envelope` and `known`, at first false, hold the wheel in each direction on
// each of (rows fine + 1, cols fine + 1) nodes.
void roll_along(
    Array<const double, 2> heights, Array<const double, 2> place, Array<const Index> turn, Index fine, WheelShape wheel,
    Array<double, 3> envelope, Array<bool, 3> known, Array<double> low) {
    for (Index k = 0; k < low.size(); ++k) {
        const double row = place(k, 0) * static_cast<double>(fine), col = place(k, 1) * static_cast<double>(fine);
        const auto top = static_cast<Index>(std::floor(row)), left = static_cast<Index>(std::floor(col));
        const double south = row - static_cast<double>(top), east = col - static_cast<double>(left);
        double total = 0.0;
        for (Index i = top; i <= top + 1; ++i) {
            for (Index j = left; j <= left + 1; ++j) {
                double& height = envelope(turn[k], i, j);
                if (!known(turn[k], i, j)) height = wheel_height(heights, fine, wheel, turn[k], i, j);
                known(turn[k], i, j) = true;
                total += height * ((i > top ? south : 1.0 - south) * (j > left ? east : 1.0 - east));
            }
        }
        low[k] = total;
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::WheelShape, starts, row, col, rise)
BUMPY_RECORD(bumpy::PitchSamples, starts, node, weight, bounds)
BUMPY_RECORD(bumpy::WheelRows, fine, wheel, samples)
BUMPY_RECORD(bumpy::Poses, wheel_node, wheel_weight, belly_node, belly_weight, wheelbase, belly_half, clearance)

BUMPY_LOOPS(motion_operator, ride_patches, move_over_patches, roll_along)
